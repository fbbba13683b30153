#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

#include "gateway/foxglove/protocol.h"

namespace splatbus::gateway::foxglove {

/// What waits to be sent to one client. Answers go before data and are never left out; of data the oldest goes when
/// there is no room. Not thread-safe.
class Outbox {
 public:
  static constexpr std::size_t kMaxMessages = 1024, kMaxAnswers = 1024, kMaxAnswerBytes = std::size_t{40} << 20;

  explicit Outbox(std::size_t max_data_bytes) : max_data_bytes_(max_data_bytes) {}

  /// False when so many answers wait that the client cannot be reading them.
  [[nodiscard]] bool answer(OutgoingMessage message) {
    answer_bytes_ += message.bytes();
    answers_.push_back(std::move(message));
    return answers_.size() <= kMaxAnswers && (answer_bytes_ <= kMaxAnswerBytes || answers_.size() == 1);
  }

  void data(OutgoingMessage message) {
    data_bytes_ += message.bytes();
    data_.push_back(std::move(message));
    while (data_bytes_ > max_data_bytes_ || data_.size() > kMaxMessages) {
      data_bytes_ -= data_.front().bytes();
      data_.pop_front();
      ++dropped_;
    }
  }

  [[nodiscard]] std::optional<OutgoingMessage> take() {
    std::deque<OutgoingMessage>& from = answers_.empty() ? data_ : answers_;
    if (from.empty()) return std::nullopt;
    OutgoingMessage message = std::move(from.front());
    (answers_.empty() ? data_bytes_ : answer_bytes_) -= message.bytes();
    from.pop_front();
    return message;
  }

  [[nodiscard]] std::size_t bytes() const { return data_bytes_ + answer_bytes_; }
  [[nodiscard]] std::uint64_t dropped() const { return dropped_; }  ///< messages, so far

 private:
  std::size_t max_data_bytes_, data_bytes_ = 0, answer_bytes_ = 0;
  std::uint64_t dropped_ = 0;
  std::deque<OutgoingMessage> answers_, data_;
};

}  // namespace splatbus::gateway::foxglove
