#pragma once

#include <flatbuffers/flatbuffers.h>

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/context.h"
#include "bus/tensor.h"
#include "wire/topics.h"

namespace splatbus::bus {

/// What the caller says of a message; topic and publisher give the rest of wire::Header.
struct MessageInfo {
  std::int64_t capture_ns = 0;
  std::string latch_key;
  std::vector<OutgoingTensor> tensors;
};

/// Publishes any topics, from any thread. Never blocks; at the high-water mark ZeroMQ drops, and readers see the gap in
/// `sequence`.
class Publisher {
 public:
  explicit Publisher(std::shared_ptr<Context> context) : context_(std::move(context)) {}

  /// `build` receives the builder and the finished Header, and returns the root table's offset:
  ///   publisher.publish(topics::kViewerPose, [&](auto& builder, auto header) {
  ///     return wire::CreateViewerPose(builder, header, ...); });
  /// Every table that it needs (strings, vectors) is made inside. Inline tensors become the third frame. Returns the
  /// message's sequence.
  template <class Table, class Build>
  std::uint64_t publish(const Topic<Table>& topic, const MessageInfo& info, Build&& build) const {
    flatbuffers::FlatBufferBuilder builder(1024);
    const auto header = make_header(builder, topic.name, topic.schema, topic.latch, info);
    const flatbuffers::Offset<Table> root = build(builder, header);
    builder.Finish(root);
    return send({builder.GetBufferPointer(), builder.GetSize()}, topic.name, topic.latch, info);
  }
  template <class Table, class Build>
  std::uint64_t publish(const Topic<Table>& topic, Build&& build) const {
    return publish(topic, MessageInfo(), std::forward<Build>(build));
  }

  /// How a message that was published before is published again.
  struct Again {
    std::uint64_t epoch = 0;  ///< not before the context's, so that its sequences begin a new count
    std::int64_t capture_ns = 0, publish_ns = 0;
    std::vector<OutgoingTensor> tensors;  ///< all of the header's, in its order
  };
  /// `body` verifies as an Envelope; its header is written anew in place, and what else it says stays. Throws Error
  /// when it is of another source than this, or lacks a field that it takes.
  std::uint64_t publish_again(std::string_view topic, std::span<std::uint8_t> body, const Again& again) const;

  [[nodiscard]] const std::shared_ptr<Context>& context() const { return context_; }

 private:
  /// Throws Error when the topic has no name or too long a one, and when a tensor cannot be sent.
  flatbuffers::Offset<wire::Header> make_header(flatbuffers::FlatBufferBuilder& builder, std::string_view topic,
                                                std::string_view schema, bool latch, const MessageInfo& info) const;
  std::uint64_t send(std::span<const std::uint8_t> body, std::string_view topic, bool latch,
                     const MessageInfo& info) const;
  [[nodiscard]] std::vector<wire::Span> place(std::string_view topic, const MessageInfo& info,
                                              std::size_t& payload_bytes) const;
  [[nodiscard]] std::shared_ptr<Slab> private_slab(std::uint64_t id) const;

  std::shared_ptr<Context> context_;
};

}  // namespace splatbus::bus
