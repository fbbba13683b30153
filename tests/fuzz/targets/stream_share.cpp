// What a replica of the streamer says to the others.
#include <stdexcept>

#include "streamer/share_message.h"
#include "target.h"

namespace streamer = splatbus::streamer;
namespace wire = splatbus::wire;
using splatbus::fuzz::require;

SPLATBUS_FUZZ_TARGET(stream_share, bytes) {
  flatbuffers::Verifier verifier(bytes.data(), bytes.size());
  if (!verifier.VerifyBuffer<wire::StreamShare>(nullptr)) return;
  try {
    const streamer::ShareMessage said = streamer::read_share(*flatbuffers::GetRoot<wire::StreamShare>(bytes.data()));
    require(!said.pages || said.pages->size() <= streamer::kMaxSharePages, "pages are bounded");
    require(said.wants.size() <= streamer::kMaxShareWants, "wants are bounded");
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(
        streamer::write_share(builder, wire::CreateHeaderDirect(builder, "StreamShare", "streamer-2"), said));
    const streamer::ShareMessage again =
        streamer::read_share(*flatbuffers::GetRoot<wire::StreamShare>(builder.GetBufferPointer()));
    require(again.deltas.size() == said.deltas.size() && again.visibility.size() == said.visibility.size(),
            "what was read can be said");
    require(again.answers.size() == said.answers.size() && again.wants == said.wants, "to those who want it");
  } catch (const std::runtime_error&) {  // refused
  }
}
