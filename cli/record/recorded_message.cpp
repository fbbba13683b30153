#include "recorded_message.h"

#include <flatbuffers/flatbuffers.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstring>

#include "bus/error.h"
#include "bus/frames.h"
#include "wire/capture_generated.h"
#include "wire/engine_generated.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::size_t kMaxDataBytes = bus::max_body_bytes + static_cast<std::size_t>(bus::max_frame_bytes);

bool is_recorded(const wire::Tensor& tensor, bool with_slabs) {
  return with_slabs || tensor.span()->storage() == wire::Storage::Inline;
}

const wire::Header* verified(std::vector<std::uint8_t>& body, std::string& why) {
  // Borrowed: nobody keeps the frame.
  const zmq::message_t frame(
      body.data(), body.size(), [](void*, void*) {}, nullptr);
  return bus::verified_header(frame, why);
}

bool lies_behind(const wire::Span& span, std::size_t bytes) {
  return span.offset() > bytes || span.bytes() > bytes - span.offset();
}

template <class Table>
Table* mutable_root(std::vector<std::uint8_t>& body, const wire::Header& header) {
  if (header.schema()->string_view() != kSchema<Table>) return nullptr;
  flatbuffers::Verifier verifier(body.data(), body.size());
  return verifier.VerifyBuffer<Table>(nullptr) ? flatbuffers::GetMutableRoot<Table>(body.data()) : nullptr;
}

void shift_scene(wire::SceneState& scene, std::uint64_t shift) {
  const auto shifted = [&](std::uint64_t version) { return version == 0 ? 0 : version + shift; };
  scene.mutate_version(shifted(scene.version()));
  wire::Light& light = *scene.mutable_light();
  light.mutate_sun_depth_version(shifted(light.sun_depth_version()));
  if (light.mutable_sources() == nullptr) return;
  for (flatbuffers::uoffset_t i = 0; i < light.sources()->size(); ++i) {
    auto* source = const_cast<wire::LightSource*>(light.sources()->Get(i));  // NOLINT: of our own copy
    source->mutate_depth_version(shifted(source->depth_version()));
  }
}

template <class Table>
bool shift_scene_of(std::vector<std::uint8_t>& body, const wire::Header& header, std::uint64_t shift) {
  auto* const root = mutable_root<Table>(body, header);
  if (root != nullptr) shift_scene(*root->mutable_scene(), shift);
  return root != nullptr;
}

}  // namespace

std::size_t recorded_size(const bus::Message& message, bool with_slabs) {
  std::size_t size = message.size();
  if (message.header().tensors() == nullptr) return size;
  for (const wire::Tensor* tensor : *message.header().tensors()) {
    if (!is_recorded(*tensor, with_slabs)) continue;
    if (tensor->span()->bytes() > kMaxDataBytes || size > kMaxDataBytes) {
      throw bus::Error(fmt::format("{}: its tensors have more than {} bytes", message.topic(), kMaxDataBytes));
    }
    size = bus::aligned(size) + tensor->span()->bytes();
  }
  return size;
}

std::optional<Blob> to_recorded(const bus::Message& message, bool with_slabs) {
  Blob blob{.data = nullptr, .size = recorded_size(message, with_slabs)};
  blob.data = std::make_unique_for_overwrite<std::byte[]>(blob.size);
  std::byte* const data = blob.data.get();
  std::memcpy(data, message.bytes(), message.size());
  const auto* tensors = message.header().tensors();
  if (tensors == nullptr) return blob;

  struct Place {
    wire::Span* in_body;
    std::size_t offset, bytes;
  };
  std::vector<Place> places;
  auto* const copied =
      flatbuffers::GetMutableRoot<wire::Envelope>(static_cast<void*>(data))->mutable_header()->mutable_tensors();
  std::size_t end = message.size();
  for (flatbuffers::uoffset_t i = 0; i < tensors->size(); ++i) {
    const wire::Tensor& tensor = *tensors->Get(i);
    if (!is_recorded(tensor, with_slabs)) continue;
    const auto view = message.tensor(tensor.name()->str());
    if (!view) return std::nullopt;
    const std::size_t offset = bus::aligned(end);
    if (view->bytes() != tensor.span()->bytes()) {
      throw bus::Error(fmt::format("{}: two tensors have one name", message.topic()));
    }
    std::memset(data + end, 0, offset - end);
    end = offset + view->bytes();
    if (!view->copy(data + offset)) return std::nullopt;
    places.push_back({copied->GetMutableObject(i)->mutable_span(), offset, view->bytes()});
  }
  // Only now: the tables of a hostile message overlap.
  for (const Place& place : places) {
    *place.in_body = wire::Span(0, 0, place.offset, place.bytes, wire::Storage::Inline);
  }
  return blob;
}

RecordedMessage::RecordedMessage(std::string_view topic, std::span<const std::byte> data) {
  const auto fail = [&](const std::string& why) { throw bus::Error(fmt::format("{}: {}", topic, why)); };
  // The body ends where the first tensor begins.
  std::size_t body_bytes = data.size();
  std::string why;
  body_.resize(std::min(data.size(), bus::max_body_bytes));
  std::memcpy(body_.data(), data.data(), body_.size());
  header_ = verified(body_, why);
  if (header_ == nullptr) fail(why);
  if (header_->tensors() != nullptr) {
    for (const wire::Tensor* tensor : *header_->tensors()) {
      const wire::Span& span = *tensor->span();
      if (span.storage() != wire::Storage::Inline) continue;
      if (lies_behind(span, data.size())) {
        fail(fmt::format("{} bytes of a tensor at {} leave its {} bytes", span.bytes(), span.offset(), data.size()));
      }
      body_bytes = std::min<std::size_t>(body_bytes, span.offset());
    }
  }
  if (body_bytes > bus::max_body_bytes) fail(fmt::format("a body of {} bytes", body_bytes));
  body_.resize(body_bytes);
  header_ = verified(body_, why);
  if (header_ == nullptr) fail(why);
  if (header_->tensors() == nullptr) return;
  for (const wire::Tensor* tensor : *header_->tensors()) {
    const wire::Span& span = *tensor->span();
    bus::OutgoingTensor outgoing{.name = tensor->name()->str(),
                                 .shape = {tensor->shape()->begin(), tensor->shape()->end()},
                                 .type = tensor->type(),
                                 .span = span};
    if (bus::tensor_bytes(outgoing.shape, outgoing.type) != span.bytes()) {
      fail(fmt::format("tensor '{}' has {} bytes, which its shape does not", bus::printable(outgoing.name),
                       span.bytes()));
    }
    if (span.storage() == wire::Storage::Inline) {
      if (lies_behind(span, data.size())) fail("its tensors overlap");
      outgoing.inline_data = data.data() + span.offset();
    } else {
      lacks_tensors_ = true;
    }
    tensors_.push_back(std::move(outgoing));
  }
}

void RecordedMessage::shift_scene_version(std::uint64_t shift) {
  if (shift_scene_of<wire::SceneUpdate>(body_, *header_, shift) ||
      shift_scene_of<wire::SceneLightDepth>(body_, *header_, shift) ||
      shift_scene_of<wire::CaptureInput>(body_, *header_, shift) ||
      shift_scene_of<wire::CaptureReference>(body_, *header_, shift) ||
      shift_scene_of<wire::CaptureProbe>(body_, *header_, shift)) {
    return;
  }
  auto* const relit = mutable_root<wire::RelightVisibility>(body_, *header_);
  if (relit != nullptr && relit->scene_version() != 0) relit->mutate_scene_version(relit->scene_version() + shift);
}

}  // namespace splatbus::cli
