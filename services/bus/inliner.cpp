#include "bus/inliner.h"

#include <flatbuffers/flatbuffers.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstring>

#include "bus/error.h"
#include "bus/tensor.h"

namespace splatbus::bus_service {

bool has_slab_tensors(const wire::Header& header) {
  if (header.tensors() == nullptr) return false;
  return std::any_of(header.tensors()->begin(), header.tensors()->end(),
                     [](const wire::Tensor* tensor) { return tensor->span()->storage() != wire::Storage::Inline; });
}

std::optional<bus::Frames> inline_slab_tensors(const bus::Frames& frames, const FindSlab& find_slab,
                                               const UnsentBytes& unsent) {
  bus::Frames result;
  result.topic.rebuild(frames.topic.data(), frames.topic.size());
  result.body = unsent.copy(frames.body);
  auto* header = flatbuffers::GetMutableRoot<wire::Envelope>(result.body.data())->mutable_header();
  auto* tensors = header->mutable_tensors();

  struct Part {
    std::shared_ptr<bus::Slab> slab;
    wire::Span* in_body;
    wire::Span from;
    std::size_t offset;
  };
  std::vector<Part> parts;
  std::size_t bytes = frames.payload.size();
  for (flatbuffers::uoffset_t i = 0; tensors != nullptr && i < tensors->size(); ++i) {
    auto* span = tensors->GetMutableObject(i)->mutable_span();
    if (span->storage() == wire::Storage::Inline) continue;
    if (span->storage() != wire::Storage::Slab) throw bus::Error("a tensor's storage does not exist");
    auto slab = find_slab(span->slab());
    if (slab == nullptr) return std::nullopt;
    (void)slab->slot_of(*span);  // throws when the span leaves its slot
    const std::size_t offset = bus::aligned(bytes);
    if (offset + span->bytes() > static_cast<std::size_t>(bus::max_frame_bytes)) {
      throw bus::Error(fmt::format("its tensors have more than the {} bytes of a frame", bus::max_frame_bytes));
    }
    bytes = offset + span->bytes();
    parts.push_back({std::move(slab), span, *span, offset});
  }
  // Only now, and looked at again: the tables of a hostile message overlap.
  for (const Part& part : parts) {
    *part.in_body = wire::Span(0, 0, part.offset, part.from.bytes(), wire::Storage::Inline);
  }
  std::string why;
  const wire::Header* written = bus::verified_header(result.body, why);
  if (written == nullptr || has_slab_tensors(*written)) throw bus::Error("its tensors overlap");

  result.payload = unsent.make(bytes);
  result.has_payload = true;
  auto* payload = result.payload.data<std::byte>();
  std::size_t end = frames.payload.size();
  if (end > 0) std::memcpy(payload, frames.payload.data(), end);
  for (const auto& part : parts) {
    std::memset(payload + end, 0, part.offset - end);
    if (!part.slab->copy(part.from, payload + part.offset)) return std::nullopt;
    end = part.offset + part.from.bytes();
  }
  return result;
}

}  // namespace splatbus::bus_service
