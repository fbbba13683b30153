#pragma once

#include <flatbuffers/flatbuffers.h>

#include <memory>
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
    return send(builder, topic.name, topic.latch, info);
  }
  template <class Table, class Build>
  std::uint64_t publish(const Topic<Table>& topic, Build&& build) const {
    return publish(topic, MessageInfo(), std::forward<Build>(build));
  }

  [[nodiscard]] const std::shared_ptr<Context>& context() const { return context_; }

 private:
  /// Throws Error when the topic has no name or too long a one, and when a tensor cannot be sent.
  flatbuffers::Offset<wire::Header> make_header(flatbuffers::FlatBufferBuilder& builder, std::string_view topic,
                                                std::string_view schema, bool latch, const MessageInfo& info) const;
  std::uint64_t send(flatbuffers::FlatBufferBuilder& builder, std::string_view topic, bool latch,
                     const MessageInfo& info) const;
  [[nodiscard]] std::vector<wire::Span> place(std::string_view topic, const MessageInfo& info,
                                              std::size_t& payload_bytes) const;
  [[nodiscard]] std::shared_ptr<Slab> private_slab(std::uint64_t id) const;

  std::shared_ptr<Context> context_;
};

}  // namespace splatbus::bus
