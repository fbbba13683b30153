#pragma once

#include <flatbuffers/flatbuffers.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/context.h"
#include "bus/error.h"
#include "bus/tensor.h"
#include "wire/topics.h"

namespace splatbus::bus {

/// A received message, its Header verified. The root is verified when it is asked for as a type.
class Message {
 public:
  [[nodiscard]] const std::string& topic() const { return topic_; }
  [[nodiscard]] const wire::Header& header() const { return *header_; }

  /// The root as `T`, whose Header must name its schema. Throws Error naming topic, source, sequence and what was wrong
  /// (another schema, or a buffer that does not verify).
  template <class T>
  [[nodiscard]] const T& root(std::string_view schema = kSchema<T>) const {
    require_schema(schema);
    flatbuffers::Verifier verifier(bytes(), size());
    if (!verifier.VerifyBuffer<T>(nullptr)) throw_malformed(schema);
    return *flatbuffers::GetRoot<T>(bytes());
  }

  /// A tensor by name; nullopt when the message has none of that name, or when its slab is gone or its slot already
  /// overwritten (a lost frame: count it and go on). Throws Error when it lies (shape, size, bounds).
  [[nodiscard]] std::optional<TensorView> tensor(const std::string& name) const;

  /// The same, and throws Error too when type or rank differ. A 0 in `shape` matches any size.
  [[nodiscard]] std::optional<TensorView> tensor(const std::string& name, ElementType type,
                                                 const std::vector<std::uint32_t>& shape) const;

  /// Whether there is a tensor of that name, wherever its bytes are by now.
  [[nodiscard]] bool announces(const std::string& name) const;

  /// Like tensor(), as a message's span for handing on in a message of one's own, without a copy. Inline tensors come
  /// back with inline_data pointing into this message.
  [[nodiscard]] std::optional<OutgoingTensor> forward_tensor(const std::string& name) const;

  [[nodiscard]] const std::uint8_t* bytes() const;
  [[nodiscard]] std::size_t size() const;

 private:
  friend class Subscriber;
  void require_schema(std::string_view schema) const;
  [[noreturn]] void throw_malformed(std::string_view schema) const;
  struct Content;
  std::string topic_;
  const wire::Header* header_ = nullptr;
  std::shared_ptr<Content> content_;
  std::shared_ptr<Context> context_;
};

/// Reads topics: whole ones with a handler each (on()), or by name for receive(), by prefix where the name ends in '*'.
/// Not thread-safe: one a thread.
///
/// Whatever does not verify as an Envelope is counted and logged with its topic, and skipped. Latched messages that
/// were seen already, by (source, epoch, topic, latch key, sequence), are dropped. Gaps in the sequence of a (source,
/// topic) are counted, from the first message on that was not held by the broker.
class Subscriber {
 public:
  explicit Subscriber(std::shared_ptr<Context> context, const std::vector<std::string>& topics = {});
  ~Subscriber();
  Subscriber(Subscriber&&) noexcept;
  Subscriber& operator=(Subscriber&&) noexcept;

  /// Subscribes, and has dispatch() call `handle(const Table&, const Message&)` for messages of that topic: with a root
  /// that names the topic's schema and verifies. A handler throws to refuse a message.
  template <class Table, class Handle>
  Subscriber& on(const Topic<Table>& topic, Handle handle) {
    add_handler(topic.name, [schema = topic.schema, handle = std::move(handle)](const Message& message) {
      handle(message.root<Table>(schema), message);
    });
    return *this;
  }

  /// Calls the handler of the message's topic. False when the message does not verify or the handler threw: that is
  /// counted in refused() and logged with topic, source and reason, once a second at most for each topic and source.
  bool dispatch(const Message& message);

  /// Waits up to `timeout` for a message, then dispatches what is there, `max_messages` at most. Returns how many.
  std::size_t dispatch_all(std::chrono::milliseconds timeout, std::size_t max_messages = 256);

  /// The same for the newest messages only, as keep_newest() has it.
  std::size_t dispatch_newest(std::chrono::milliseconds timeout);

  /// Waits until the broker knows of the subscriptions: what is published from then on arrives. False after `timeout`.
  /// Needed only where a lost answer is not asked for again (a request is published right after); messages that come
  /// meanwhile are kept for receive().
  [[nodiscard]] bool wait_connected(std::chrono::milliseconds timeout);

  /// The next message, or nullopt after `timeout` (0: what is there now) and when a signal arrives.
  std::optional<Message> receive(std::chrono::milliseconds timeout);

  /// Waits for a message, reads everything that is there, and keeps the newest, as keep_newest() does.
  std::vector<Message> receive_newest(std::chrono::milliseconds timeout);

  [[nodiscard]] std::uint64_t lost() const;       ///< by sequence gaps
  [[nodiscard]] std::uint64_t malformed() const;  ///< not even an Envelope
  [[nodiscard]] std::uint64_t refused() const;    ///< by dispatch()
  [[nodiscard]] void* zmq_socket() const;         ///< for zmq::poll beside other sockets

 private:
  void add_handler(std::string_view topic, std::function<void(const Message&)> handle);
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The newest of each (topic, source, latch key), in order of arrival. Messages that are not latched count by the same
/// three, so that a publisher can set `latch_key` without `latch` to say what replaces what (one key a camera). Where
/// every message counts, this is not for you.
[[nodiscard]] std::vector<Message> keep_newest(std::vector<Message> messages);

/// Runs `handle` for a message, and turns an exception that it throws into a logged line that names the message: for
/// work on a message outside of its handler. False when it threw.
bool guarded(const Message& message, const std::function<void()>& handle);

}  // namespace splatbus::bus
