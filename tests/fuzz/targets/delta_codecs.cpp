// Payloads of the small packets: the first byte chooses the codec, then come count, raw_bytes and how many are held.
#include "stream/codecs.h"
#include "stream_layouts.h"
#include "target.h"

namespace {

namespace stream = splatbus::stream;
using splatbus::fuzz::require;

void require_slots(const std::vector<std::uint32_t>& slots, std::size_t count, std::size_t held) {
  require(slots.size() == count, "as many as it says");
  for (std::size_t i = 0; i < slots.size(); ++i) {
    require(slots[i] < held && (i == 0 || slots[i - 1] < slots[i]), "ascending slots that exist");
  }
}

void decode(splatbus::fuzz::Input& input) {
  const auto choice = input.number();
  const std::size_t count = input.number<std::uint32_t>() % (stream::kMaxDeltaGaussians * 2);
  const std::size_t raw_bytes = input.number<std::uint32_t>();
  const std::size_t held = input.number<std::uint16_t>();
  const auto payload = input.rest();
  switch (choice % 6) {
    case 0: {
      const std::size_t channels = 1 + choice / 6 % 4;
      const auto delta = stream::decode_delta(payload, raw_bytes, count, channels, held);
      require_slots(delta.slots, count, held);
      require(delta.residuals.size() == channels, "every channel");
      break;
    }
    case 1:
      require_slots(stream::decode_slots(payload, raw_bytes, count, held), count, held);
      break;
    case 2:
      require(stream::decode_ids(payload, raw_bytes, count).size() == count, "as many ids");
      break;
    case 3: {
      const auto change = stream::decode_slot_ids(payload, raw_bytes, count, held);
      require_slots(change.slots, count, held);
      require(change.ids.size() == count, "an id each");
      break;
    }
    case 4: {
      const auto change = stream::decode_slot_values(payload, raw_bytes, count, held);
      require_slots(change.slots, count, held);
      require(change.values.size() == count, "a value each");
      break;
    }
    default: {
      const stream::StreamLayout& layout = splatbus::fuzz::layout(choice / 6);
      const auto chunk = stream::decode_chunk(payload, layout, count);
      require(chunk.count() == count, "as many Gaussians");
      splatbus::fuzz::require_within_limits(chunk, layout);
    }
  }
}

}  // namespace

SPLATBUS_FUZZ_TARGET(delta_codecs, bytes) {
  splatbus::fuzz::Input input(bytes);
  try {
    decode(input);
  } catch (const stream::StreamError&) {  // refused
  }
}
