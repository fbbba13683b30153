#pragma once

#include <flatbuffers/flatbuffers.h>

#include <memory>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/tensor.h"

namespace splatbus::bus {

/// What the caller says of a message; the publisher fills in the rest of wire::Header.
struct MessageInfo {
  std::string schema;  ///< "EngineFrame/1"
  std::int64_t capture_ns = 0;
  bool latch = false;
  std::string latch_key;
  std::vector<OutgoingTensor> tensors;
};

/// Publishes one topic. Not thread-safe: one a thread. Never blocks; at the high-water mark ZeroMQ drops, and readers
/// see the gap in `sequence`.
class Publisher {
 public:
  Publisher(std::shared_ptr<Context> context, std::string topic);
  ~Publisher();
  Publisher(Publisher&&) noexcept;
  Publisher& operator=(Publisher&&) noexcept;

  /// `build` receives the builder and the finished Header, and returns the root table's offset:
  ///   publisher.publish({.schema = "ViewerPose/1"}, [&](auto& b, auto header) {
  ///     return wire::CreateViewerPose(b, header, ...); });
  /// Every table that it needs (strings, vectors) is made inside. Inline tensors become the third frame.
  template <class Build>
  void publish(const MessageInfo& info, Build&& build) {
    flatbuffers::FlatBufferBuilder builder(1024);
    const auto header = make_header(builder, info);
    builder.Finish(build(builder, header));
    send(builder, info);
  }

  [[nodiscard]] const std::string& topic() const;
  [[nodiscard]] const std::shared_ptr<Context>& context() const;
  [[nodiscard]] std::uint64_t sequence() const;  ///< of the last message

 private:
  flatbuffers::Offset<wire::Header> make_header(flatbuffers::FlatBufferBuilder& builder, const MessageInfo& info);
  void send(flatbuffers::FlatBufferBuilder& builder, const MessageInfo& info);
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::bus
