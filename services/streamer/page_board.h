#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "stream/stream_model.h"
#include "streamer/endpoint.h"
#include "streamer/share_message.h"

namespace splatbus::streamer {

/// A delta as it is sent to anybody.
struct SharedDelta {
  std::uint64_t number = 0;
  SharedPacket packet;
  std::vector<stream::DeltaPacket::Step> steps;
  std::vector<stream::PageVersion> gone;
};

/// A page as it is sent to anybody, in parts.
struct SharedPage {
  std::uint32_t version = 0, structure = 0;
  std::vector<SharedPacket> parts;
  bool to_hold = true;  ///< the model knows that somebody goes on with it by deltas
};

/// All pages that there are, by number, and of which of them other replicas make the packets.
struct BoardPages {
  std::shared_ptr<const std::vector<stream::OfferedPage>> all;
  std::vector<std::uint32_t> of_others;  ///< ascending
};

/// What viewers may be sent: the pages that are offered, and the last deltas, each packet made once, here or by another
/// replica. One thread.
class PageBoard {
 public:
  PageBoard(stream::StreamModel& model, std::size_t history_bytes) : model_(model), max_bytes_(history_bytes) {}

  /// After a tick of the model. Returns the pages that ended, and in `changed` those that viewers' manifests lack or
  /// have otherwise.
  std::vector<std::uint32_t> add(stream::StreamUpdate update, std::vector<stream::OfferedPage>& changed) {
    return add(std::move(update), {.all = model_.offered(), .of_others = {}}, changed);
  }
  /// Where others encode some of the pages.
  std::vector<std::uint32_t> add(stream::StreamUpdate update, BoardPages pages,
                                 std::vector<stream::OfferedPage>& changed);
  /// After the model was reset.
  void clear();

  [[nodiscard]] const std::vector<stream::OfferedPage>& offered() const { return *offered_; }
  [[nodiscard]] const stream::OfferedPage* find(std::uint32_t page) const;
  /// Oldest first.
  [[nodiscard]] const std::deque<SharedDelta>& deltas() const { return deltas_; }
  /// Grows with every change of what is offered.
  [[nodiscard]] std::uint64_t edition() const { return edition_; }

  /// As the model has it now; null when it is no more, or another replica's that has not come yet: then it is asked
  /// for. In one part, or in parts of stream::kBlockRows lanes. `to_hold`: for somebody who goes on with it by deltas.
  [[nodiscard]] std::shared_ptr<const SharedPage> page(std::uint32_t page, bool in_parts, bool to_hold = true);
  /// How a page sees each light, the same; empty where page() would be null.
  [[nodiscard]] std::vector<SharedPacket> page_visibility(std::uint32_t page);
  [[nodiscard]] bool is_of_others(std::uint32_t page) const;
  /// In all pages; nullopt where none is of others.
  [[nodiscard]] std::optional<std::size_t> gaussians() const { return gaussians_; }
  /// Their lights' visibility has changed: what was made of them does not tell.
  void forget(const std::vector<wire::SeenPage>& pages);
  [[nodiscard]] std::vector<stream::EncodedPacket> manifest_packets(std::span<const stream::OfferedPage> pages,
                                                                    std::span<const std::uint32_t> gone,
                                                                    bool whole) const {
    return model_.manifest_packets(pages, gone, whole, gaussians_);
  }

  /// Of all of them, and the Layout: made once an edition, for whoever asks.
  [[nodiscard]] const std::vector<SharedPacket>& manifest();
  [[nodiscard]] SharedPacket layout();

  /// Another replica's answer; what nobody here wanted, or has become older than what is offered, is not taken.
  void take(ShareAnswer answer);
  /// What is to be asked of others, each thing at most every kAskNs and only as long as somebody needs it.
  [[nodiscard]] std::vector<ShareWant> take_wants(std::int64_t now_ns);
  static constexpr std::int64_t kAskNs = 200'000'000;
  /// Visibility of several replicas is of several scenes: its version is written anew so that none runs backwards.
  void stamp(stream::EncodedPacket& visibility);
  [[nodiscard]] std::uint64_t visibility_version() const { return visibility_version_; }
  /// Whether somebody may look what hides what: so often that all who do take a fifth of one core at most.
  [[nodiscard]] bool may_look(std::int64_t now_ns);
  /// Bytes of a page, as far as that is known.
  [[nodiscard]] double bytes_of(const stream::OfferedPage& page) const;

 private:
  void offer_others(BoardPages& pages);
  /// Visibility of a page whose lanes have not become others since.
  [[nodiscard]] bool is_of_now(const ShareAnswer& seen) const;
  void need(const ShareWant& want) { wanted_[want].needed = true; }
  void learn_bytes(std::uint32_t page, std::size_t bytes);

  stream::StreamModel& model_;
  std::size_t max_bytes_, bytes_ = 0;
  std::uint64_t number_ = 0, edition_ = 0;
  double bytes_per_gaussian_ = 24;
  std::shared_ptr<const std::vector<stream::OfferedPage>> offered_ =
      std::make_shared<std::vector<stream::OfferedPage>>();
  std::deque<SharedDelta> deltas_;
  std::vector<SharedPacket> manifest_;
  SharedPacket layout_;
  std::uint64_t manifest_edition_ = 0, layout_edition_ = 0;
  std::map<std::pair<std::uint32_t, bool>, std::shared_ptr<const SharedPage>> pages_;

  struct Wanted {
    bool needed = false;  ///< since it was asked for
    std::int64_t asked_ns = 0;
  };
  std::vector<std::uint32_t> of_others_;
  std::optional<std::size_t> gaussians_;       ///< in all pages, where others have some
  std::map<std::uint32_t, ShareAnswer> seen_;  ///< of others' pages
  std::map<ShareWant, Wanted> wanted_;
  std::uint64_t visibility_version_ = 0;
  std::int64_t next_look_ns_ = 0;
};

}  // namespace splatbus::streamer
