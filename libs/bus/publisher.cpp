#include "bus/publisher.h"

#include <fmt/format.h>

#include <cstring>
#include <utility>

#include "bus/context_impl.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "bus/tensor.h"

namespace splatbus::bus {

// A slab that nobody else can map: its tensors are inlined.
std::shared_ptr<Slab> Publisher::private_slab(std::uint64_t id) const {
  auto& bus = *context_->impl_;
  if (bus.slabs) return nullptr;
  const std::scoped_lock lock(bus.mutex);
  const auto found = bus.private_slabs.find(id);
  return found == bus.private_slabs.end() ? nullptr : found->second.lock();
}

// Where in the payload each tensor goes; its slab for those that stay there.
std::vector<wire::Span> Publisher::place(std::string_view topic, const MessageInfo& info,
                                         std::size_t& payload_bytes) const {
  std::vector<wire::Span> spans;
  payload_bytes = 0;
  for (const auto& tensor : info.tensors) {
    const std::size_t bytes = tensor_bytes(tensor.shape, tensor.type);
    if (tensor.inline_data == nullptr && bytes > 0) {
      if (bytes != tensor.span.bytes()) {
        throw Error(fmt::format("{}: tensor '{}' has {} bytes by its shape, {} by its span", topic, tensor.name, bytes,
                                tensor.span.bytes()));
      }
      if (context_->address().is_local()) {
        spans.push_back(tensor.span);
        continue;
      }
      if (private_slab(tensor.span.slab()) == nullptr) {
        throw Error(fmt::format("{}: tensor '{}' lies in a slab that is not of this process", topic, tensor.name));
      }
    }
    payload_bytes = aligned(payload_bytes);
    spans.emplace_back(0, 0, payload_bytes, bytes, wire::Storage::Inline);
    payload_bytes += bytes;
  }
  if (payload_bytes > static_cast<std::size_t>(max_frame_bytes)) {
    throw Error(fmt::format("{}: {} bytes of inline tensors are more than a frame may have", topic, payload_bytes));
  }
  return spans;
}

flatbuffers::Offset<wire::Header> Publisher::make_header(flatbuffers::FlatBufferBuilder& builder,
                                                         std::string_view topic, std::string_view schema, bool latch,
                                                         const MessageInfo& info) const {
  if (topic.empty() || topic.size() > max_topic_bytes) {
    throw Error(fmt::format("'{}' is not a valid topic", printable(topic)));
  }
  std::size_t payload_bytes = 0;
  const auto spans = place(topic, info, payload_bytes);
  std::vector<flatbuffers::Offset<wire::Tensor>> tensors;
  for (std::size_t i = 0; i < spans.size(); ++i) {
    const auto& tensor = info.tensors[i];
    const auto name = builder.CreateString(tensor.name);
    const auto shape = builder.CreateVector(tensor.shape);
    tensors.push_back(wire::CreateTensor(builder, name, &spans[i], shape, tensor.type));
  }
  const auto schema_text = builder.CreateString(schema);
  const auto source = builder.CreateString(context_->source());
  const auto key = info.latch_key.empty() ? 0 : builder.CreateString(info.latch_key);
  const auto tensor_vector = tensors.empty() ? 0 : builder.CreateVector(tensors);
  // Every scalar is stored, so that the outbox and the broker can change sequence and resent in place.
  builder.ForceDefaults(true);
  const auto header = wire::CreateHeader(builder, schema_text, source, 1, context_->epoch(), info.capture_ns, now_ns(),
                                         0, latch, key, tensor_vector, false);
  builder.ForceDefaults(false);
  return header;
}

std::uint64_t Publisher::publish_again(std::string_view topic, std::span<std::uint8_t> body, const Again& again) const {
  if (topic.empty() || topic.size() > max_topic_bytes)
    throw Error(fmt::format("'{}' is not a valid topic", printable(topic)));
  wire::Header& header = *flatbuffers::GetMutableRoot<wire::Envelope>(body.data())->mutable_header();
  if (header.source()->string_view() != context_->source()) {
    throw Error(fmt::format("{}: its source is '{}', not '{}'", topic, printable(header.source()->string_view()),
                            context_->source()));
  }
  const bool written = header.mutate_epoch(again.epoch) && header.mutate_sequence(1) &&
                       header.mutate_capture_ns(again.capture_ns) && header.mutate_publish_ns(again.publish_ns) &&
                       (!header.resent() || header.mutate_resent(false));
  const std::size_t tensors = header.tensors() == nullptr ? 0 : header.tensors()->size();
  if (!written || tensors != again.tensors.size()) throw Error(fmt::format("{}: its header lacks fields", topic));
  const MessageInfo info{.capture_ns = again.capture_ns,
                         .latch_key = header.latch_key() == nullptr ? "" : header.latch_key()->str(),
                         .tensors = again.tensors};
  std::size_t payload_bytes = 0;
  const auto spans = place(topic, info, payload_bytes);
  for (flatbuffers::uoffset_t i = 0; i < spans.size(); ++i) {
    *header.mutable_tensors()->GetMutableObject(i)->mutable_span() = spans[i];
  }
  return send(body, topic, header.latch(), info);
}

std::uint64_t Publisher::send(std::span<const std::uint8_t> body, std::string_view topic, bool latch,
                              const MessageInfo& info) const {
  Frames frames;
  frames.topic.rebuild(topic.data(), topic.size());
  frames.body.rebuild(body.data(), body.size());
  std::size_t payload_bytes = 0;
  const auto spans = place(topic, info, payload_bytes);
  for (std::size_t i = 0; i < spans.size(); ++i) {
    if (spans[i].storage() != wire::Storage::Inline) continue;
    if (!frames.has_payload) {
      frames.payload.rebuild(payload_bytes);
      if (payload_bytes > 0) std::memset(frames.payload.data(), 0, payload_bytes);
      frames.has_payload = true;
    }
    if (spans[i].bytes() == 0) continue;
    auto* destination = frames.payload.data<std::byte>() + spans[i].offset();
    const auto& tensor = info.tensors[i];
    if (tensor.inline_data != nullptr) {
      std::memcpy(destination, tensor.inline_data, spans[i].bytes());
    } else {
      const auto slab = private_slab(tensor.span.slab());
      if (slab == nullptr || !slab->copy(tensor.span, destination)) {
        throw Error(
            fmt::format("{}: tensor '{}': its slot was written again before it was published", topic, tensor.name));
      }
    }
  }
  return context_->impl_->outbox.send(std::move(frames), latch ? &info.latch_key : nullptr);
}

}  // namespace splatbus::bus
