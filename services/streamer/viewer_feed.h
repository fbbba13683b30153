#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <unordered_map>
#include <vector>

#include "bus/token_bucket.h"
#include "gaussians/light.h"
#include "streamer/page_board.h"
#include "streamer/page_weights.h"
#include "streamer/viewer_rate.h"

namespace splatbus::streamer {

/// One viewer's place in the stream: which pages it holds as far as is known, and what it is sent next. That is what
/// adds most to its own picture over its bytes: pages in view and near, and those that will be soon; then deltas of
/// what it holds; then what is far. Costs nothing but numbers and shared packets. One thread.
class ViewerFeed {
 public:
  explicit ViewerFeed(std::size_t max_gaussians) : max_gaussians_(max_gaussians) {}

  /// It holds these, of the epoch that is offered, and no others; `visibility_current`: all that has been said of their
  /// lights too.
  void resume(const PageBoard& board, const std::vector<stream::PageVersion>& held, bool visibility_current);
  /// It holds nothing: after the model was reset.
  void start_over();

  /// Goes before everything else: Layout, a whole Scene, the whole Manifest. What waits of another beginning does not.
  void begin(std::vector<SharedPacket> packets);
  /// A Manifest of what has changed. In place of many that wait a whole one is sent.
  void push_news(SharedPacket packet);
  void push_scene(SharedPacket packet) { scenes_.push_back(std::move(packet)); }
  [[nodiscard]] std::size_t scenes() const { return scenes_.size(); }
  /// A whole one is pushed in place of those that wait.
  void drop_scenes() { scenes_.clear(); }
  void push_visibility(SharedPacket packet, std::shared_ptr<const std::vector<wire::SeenPage>> pages);
  /// Of these pages' lights something has changed that it is not told: it comes page by page.
  void miss_visibility(const std::vector<wire::SeenPage>& pages);
  /// These ended otherwise than in a delta: it is told of those that it holds.
  void push_gone(const stream::StreamModel& model, std::span<const std::uint32_t> pages);
  /// It is told of all of these.
  void tell_gone(const stream::StreamModel& model, std::vector<std::uint32_t> pages);

  /// What is to be sent next; null when there is nothing, or no more than the rate allows: then waits() is true.
  [[nodiscard]] SharedPacket next(stream::StreamModel& model, PageBoard& board, const std::optional<ViewerGaze>& gaze,
                                  const ObjectTransforms& objects, std::int64_t now_ns);
  /// What next() gave was sent, as next_sequence().
  void sent(std::int64_t now_ns);
  [[nodiscard]] std::uint64_t next_sequence() const { return sequence_ + 1; }
  [[nodiscard]] bool waits() const { return waits_; }
  /// Whether it once had all pages that it has room for, since it began or started over.
  [[nodiscard]] bool was_whole() const { return was_whole_; }
  /// Beside what next() gives: counted, and numbered.
  void sent_beside(double bytes, std::int64_t now_ns);

  /// What a viewer says of what it has received.
  struct Said {
    std::uint64_t newest = 0;
    std::vector<stream::SequenceRange> missing;
    std::vector<stream::PageVersion> lacks;
    std::vector<std::uint32_t> dropped;
    double most_kbps = 0;  ///< that it wants to be sent; 0: it does not mind
  };
  /// True when packets were lost that only a new beginning replaces: Layout, Scene and Manifest again.
  [[nodiscard]] bool acknowledge(const Said& said, const stream::StreamModel& model, std::int64_t now_ns);

  /// What it wants at most; 0: it does not mind.
  void want(double most_kbps) { most_kbps_ = most_kbps; }
  [[nodiscard]] double most_kbps() const { return most_kbps_; }
  [[nodiscard]] ViewerRate& rate() { return rate_; }
  [[nodiscard]] const ViewerRate& rate() const { return rate_; }
  /// Adds the pages of which deltas are of use to it: those that it holds and that do not wait to come whole.
  void follow_pages(std::set<std::uint32_t>& pages) const;
  /// Of its rate, what deltas may be made for: most of it while they bring up to date what it holds, and little while
  /// pages have to come whole before they can.
  [[nodiscard]] double delta_bytes_per_s() const { return delta_share_ * rate_.bytes_per_s(); }
  [[nodiscard]] std::uint64_t lost_packets() const { return lost_packets_; }
  [[nodiscard]] std::uint64_t refused_pages() const { return refused_pages_; }
  [[nodiscard]] std::uint64_t whole_pages() const { return whole_pages_; }

 private:
  struct Record {
    std::uint32_t version = 0, structure = 0, count = 0;
    std::uint64_t sequence = 0;  ///< of the packet that brought it
    bool seen_stale = false;     ///< of its lights' visibility something is missing
    std::int64_t left_ns = 0;    ///< since when no delta brings it up to date and it waits to come whole; 0: one does
  };
  struct Mark {
    std::uint32_t page = 0, from_version = 0, version = 0;
  };
  /// Of a packet that was sent, until the viewer has said that it came.
  struct Trace {
    std::uint64_t sequence = 0;
    bool control = false, visibility = false;
    std::vector<Mark> marks;
    std::vector<std::uint32_t> gone;  ///< pages
  };
  struct Item {
    float score = 0;
    double bytes = 0;
    std::uint64_t delta = 0;  ///< its number; 0: a page
    std::uint32_t page = 0;
    bool visibility = false;  ///< only how it sees the lights
  };
  static constexpr std::size_t kMaxTraces = 4096;
  static constexpr std::size_t kMaxNews = 64, kMaxVisibility = 64;  ///< that wait
  enum class Kind : std::uint8_t { None, Control, News, Scene, Visibility, Gone, Part, Delta, PageVisibility };

  [[nodiscard]] SharedPacket choose(stream::StreamModel& model, PageBoard& board, const std::optional<ViewerGaze>& gaze,
                                    const ObjectTransforms& objects, std::int64_t now_ns);
  void plan(PageBoard& board, const std::optional<ViewerGaze>& gaze, const ObjectTransforms& objects,
            double budget_bytes, std::int64_t now_ns);
  /// Which pages hide which, where some are missing and it is time to look again.
  void look(PageBoard& board, const std::optional<ViewerGaze>& gaze, const ObjectTransforms& objects);
  /// What a page that is missing is worth, of a weight that knows nothing of others before it.
  [[nodiscard]] float unhidden(std::uint32_t page, float weight) const;
  void learn_delta_share(const PageBoard& board, double followed, std::int64_t since_ns);
  [[nodiscard]] double largest_packet() const;
  using Versions = std::map<std::uint32_t, std::uint32_t>;  ///< by page
  template <class Goes, class Visit>
  void walk_deltas(const PageBoard& board, Versions& versions, const Goes& goes, const Visit& visit) const;
  struct Missed {
    double bytes = 0;
    float steps = 0;  ///< that a Gaussian of the page is off
    std::uint32_t deltas = 0;
  };
  [[nodiscard]] std::set<std::uint32_t> find_missed(const PageBoard& board, const Versions& versions);
  void add_missed(const PageBoard& board, Versions versions, const std::set<std::uint32_t>& whole,
                  std::map<std::uint32_t, Missed>& all);
  void plan_deltas(const PageBoard& board, Versions& versions, std::vector<Item>& items);
  void drop_ended(const stream::StreamModel& model);
  void order(std::vector<Item> items, double budget_bytes);
  [[nodiscard]] bool make_room(stream::StreamModel& model, const stream::OfferedPage& page);
  [[nodiscard]] bool begin_item(stream::StreamModel& model, PageBoard& board, const Item& item);
  void drop_visibility();
  [[nodiscard]] bool affords(Kind kind, const SharedPacket& packet, std::int64_t now_ns);
  [[nodiscard]] static std::vector<bool> fits(const std::map<std::uint32_t, Record>& held, const SharedDelta& delta);
  void take_delta(const SharedDelta& delta, Trace& trace);
  void take_visibility(const std::vector<wire::SeenPage>& pages, bool came);
  void lose(const stream::StreamModel& model, const Trace& trace);
  void set_record(std::uint32_t page, const Record& record);
  void erase_record(std::uint32_t page);

  std::size_t max_gaussians_, gaussians_ = 0;
  std::map<std::uint32_t, Record> held_;
  std::map<std::uint32_t, std::int64_t> declined_;     ///< pages, and until when they are not sent again
  std::map<std::uint32_t, float> weights_;             ///< of the last plan
  std::unordered_map<std::uint32_t, float> seen_px2_;  ///< by page: what shows, of the last look
  std::int64_t looked_ns_ = 0;
  std::map<std::uint32_t, Missed> missed_;  ///< by page, of the last plan
  std::vector<std::uint32_t> ended_;        ///< that it holds, and that no delta of that plan ends
  std::deque<SharedPacket> control_, news_, scenes_;
  bool manifest_is_due_ = false;
  struct Visibility {
    SharedPacket packet;
    std::shared_ptr<const std::vector<wire::SeenPage>> pages;
  };
  std::deque<Visibility> visibility_;
  bus::TokenBucket visibility_bucket_{1e6, 1e5};
  struct Gone {
    SharedPacket packet;
    std::vector<std::uint32_t> pages;
  };
  std::deque<Gone> gone_;
  std::deque<Item> plan_;
  std::uint64_t planned_edition_ = 0, oldest_delta_ = 0;  ///< older deltas are of no use
  bool plan_is_all_ = false;
  double delta_share_ = 0.1;  ///< of the rate
  std::int64_t planned_ns_ = 0;

  // The page or delta that is being sent.
  std::shared_ptr<const SharedPage> page_;
  std::uint32_t page_number_ = 0, page_count_ = 0;
  std::size_t part_ = 0;
  bool page_stale_ = false;  ///< how it sees the lights has changed since it was made
  std::optional<SharedDelta> delta_;
  std::deque<SharedPacket> page_visibility_;
  std::uint32_t visibility_page_ = 0;

  Kind offered_ = Kind::None;
  SharedPacket packet_;
  bool waits_ = false, was_whole_ = false;
  double most_kbps_ = 0;
  std::uint64_t sequence_ = 0;
  std::deque<Trace> traces_;
  ViewerRate rate_;
  std::uint64_t lost_packets_ = 0, refused_pages_ = 0, whole_pages_ = 0;
};

}  // namespace splatbus::streamer
