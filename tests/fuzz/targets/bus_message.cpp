// A message on the bus, as the broker looks at it before anybody reads it: its header, and its tensors for readers over
// tcp. The first byte chooses how long its payload is; tensors in slabs are put into one that exists by the next one.
#include "bus/error.h"
#include "bus/frames.h"
#include "bus/inliner.h"
#include "bus/slab_memory.h"
#include "target.h"

namespace bus = splatbus::bus;
namespace wire = splatbus::wire;
using splatbus::fuzz::require;

namespace {

constexpr std::uint64_t kSlab = 77;

const std::shared_ptr<bus::Slab>& slab() {
  static const std::shared_ptr<bus::Slab> made = [] {
    bus::SlabDescriptor descriptor;
    descriptor.id = kSlab;
    descriptor.name = "maker/frames";
    descriptor.slots = 2;
    descriptor.slot_bytes = 5000;
    return bus::create_slab_memory(descriptor, false);
  }();
  return made;
}

void aim(zmq::message_t& body) {
  auto* header = flatbuffers::GetMutableRoot<wire::Envelope>(body.data())->mutable_header();
  if (header->mutable_tensors() == nullptr) return;
  for (flatbuffers::uoffset_t i = 0; i < header->mutable_tensors()->size(); ++i) {
    wire::Span& span = *header->mutable_tensors()->GetMutableObject(i)->mutable_span();
    span.mutate_slab(kSlab);
    span.mutate_storage(wire::Storage::Slab);
    span.mutate_generation(0);
  }
}

}  // namespace

SPLATBUS_FUZZ_TARGET(bus_message, bytes) {
  splatbus::fuzz::Input input(bytes);
  const std::size_t payload_bytes = std::size_t{input.number()} * 64;
  const bool aims = input.number() % 2 == 1;
  const auto body = input.rest();
  bus::Frames frames;
  frames.topic.rebuild("fuzz", 4);
  frames.body.rebuild(body.data(), body.size());
  frames.payload.rebuild(payload_bytes);
  frames.has_payload = payload_bytes > 0;
  std::string why;
  const auto* header = bus::verified_header(frames.body, why);
  require((header == nullptr) == !why.empty(), "a refusal says why");
  if (header == nullptr) return;
  // Where tables overlap, aiming spoils more than spans.
  if (aims) aim(frames.body);
  if (bus::verified_header(frames.body, why) == nullptr) return;
  const splatbus::bus_service::UnsentBytes unsent(std::size_t{1} << 30);
  try {
    const auto inlined = splatbus::bus_service::inline_slab_tensors(
        frames, [](std::uint64_t id) { return id == kSlab ? slab() : nullptr; }, unsent);
    if (!inlined) return;
    const auto* travelled = bus::verified_header(inlined->body, why);
    require(travelled != nullptr && !splatbus::bus_service::has_slab_tensors(*travelled), "no slab leaves the machine");
  } catch (const bus::Error&) {  // refused
  }
}
