#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <vector>

#include "stream/stream_model.h"
#include "streamer/endpoint.h"

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
};

/// What viewers may be sent: the pages that are offered, and the last deltas, each packet made once. One thread.
class PageBoard {
 public:
  PageBoard(stream::StreamModel& model, std::size_t history_bytes) : model_(model), max_bytes_(history_bytes) {}

  /// After a tick of the model. Returns the pages that ended, and in `changed` those that viewers' manifests lack or
  /// have otherwise.
  std::vector<std::uint32_t> add(stream::StreamUpdate update, std::vector<stream::OfferedPage>& changed);
  /// After the model was reset.
  void clear();

  [[nodiscard]] const std::vector<stream::OfferedPage>& offered() const { return *offered_; }
  [[nodiscard]] const stream::OfferedPage* find(std::uint32_t page) const;
  /// Oldest first.
  [[nodiscard]] const std::deque<SharedDelta>& deltas() const { return deltas_; }
  /// Grows with every change of what is offered.
  [[nodiscard]] std::uint64_t edition() const { return edition_; }

  /// As the model has it now; null when it is no more. In one part, or in parts of stream::kBlockRows lanes.
  [[nodiscard]] std::shared_ptr<const SharedPage> page(std::uint32_t page, bool in_parts);
  /// Their lights' visibility has changed: what was made of them does not tell.
  void forget(const std::vector<wire::SeenPage>& pages);
  /// Bytes of a page, as far as that is known.
  [[nodiscard]] double bytes_of(const stream::OfferedPage& page) const;

 private:
  stream::StreamModel& model_;
  std::size_t max_bytes_, bytes_ = 0;
  std::uint64_t number_ = 0, edition_ = 0;
  double bytes_per_gaussian_ = 24;
  std::shared_ptr<const std::vector<stream::OfferedPage>> offered_ =
      std::make_shared<std::vector<stream::OfferedPage>>();
  std::deque<SharedDelta> deltas_;
  std::map<std::pair<std::uint32_t, bool>, std::shared_ptr<const SharedPage>> pages_;
};

}  // namespace splatbus::streamer
