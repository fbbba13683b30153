#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <utility>
#include <vector>

#include "stream/stream_model.h"
#include "streamer/endpoint.h"
#include "streamer/page_board.h"

namespace splatbus::streamer {

/// What those who ask for pages are sent: a manifest, pages by their names; to each in the order in which it asked and
/// as fast as it reads. What waits for a peer is one manifest, in packets that all are sent, and names of so many
/// pages, until it has taken nothing for a while. One thread.
class PageAnswers {
 public:
  static constexpr std::size_t kMaxPages = 500;     ///< that wait for one peer
  static constexpr std::size_t kMaxStrangers = 16;  ///< that anything waits for
  static constexpr std::int64_t kStalledNs = 5'000'000'000;

  using Send = std::function<Endpoint::Sent(const Endpoint::Peer&, const WirePacket&)>;
  PageAnswers(PageBoard& board, stream::StreamModel& model, Send send)
      : board_(board), model_(model), send_(std::move(send)) {}

  struct Request {
    bool manifest = false;
    std::vector<stream::PageVersion> pages;
    std::uint64_t epoch = 0;
    bool is_stranger = false;
  };
  /// Sends what the peer takes now. False where too much waits already: then nothing is kept of it.
  [[nodiscard]] bool take(const Endpoint::Peer& peer, const Request& request, std::int64_t now_ns);
  /// Sends what peers take now. True when more waits for one of them to read.
  bool pump(std::int64_t now_ns);
  /// The stream has begun anew: the manifest of the one before is nobody's any more.
  void restart();

 private:
  /// A packet, or the name of a page that becomes one when its turn comes.
  struct Item {
    SharedPacket packet;
    stream::PageVersion asked;
    std::uint64_t epoch = 0;
    std::int64_t asked_ns = 0;
    bool of_manifest = false;
  };
  struct Answer {
    std::deque<Item> items;
    std::size_t manifest_left = 0;  ///< of them
    bool is_stranger = false;
    std::int64_t moved_ns = 0;  ///< when its peer last took something
  };
  /// For another replica to make them.
  struct Waiting {
    Endpoint::Peer peer;
    bool is_stranger = false;
    Item item;
  };
  enum class State : std::uint8_t { Here, Waits, Gone };

  Answer* answer_to(const Endpoint::Peer& peer, bool is_stranger, std::size_t pages, std::int64_t now_ns);
  /// False once nothing waits for that peer any more.
  bool send_some(const Endpoint::Peer& peer, Answer& answer, std::int64_t now_ns);
  void resolve_front(const Endpoint::Peer& peer, Answer& answer, std::int64_t now_ns);
  [[nodiscard]] State state_of(const Item& item, std::int64_t now_ns);
  void look_at_waiting(std::int64_t now_ns);

  PageBoard& board_;
  stream::StreamModel& model_;
  Send send_;
  std::map<Endpoint::Peer, Answer> answers_;
  std::deque<Waiting> waiting_;
};

}  // namespace splatbus::streamer
