#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "gaussians/model.h"
#include "gaussians/pages.h"
#include "stream/packets.h"
#include "stream/page_surfels.h"
#include "stream/replica.h"

// What a StreamModel is told and what it makes.
namespace splatbus::stream {

/// As relight says it.
struct LightsVisibility {
  std::span<const std::uint32_t>
      light_ids;                           ///< ascending, 0 is the sun; those that the scene does not have are left out
  std::span<const std::uint8_t> of_index;  ///< [light_ids][indices of the model], 255 sees all of the light
  std::uint64_t scene_version = 0;
  std::uint32_t page_indices = 0;         ///< of a page; with `covered`
  std::span<const std::uint8_t> covered;  ///< of each page of indices: 0 where of_index says nothing; empty: it is all
};

/// A stream that another streamer has begun and this one goes on with, each with pages of its own.
struct StreamOrigin {
  std::uint64_t epoch = 0;
  ParameterLayout layout;     ///< that this is about: a model of another one begins a stream of its own
  float mean_step = 0;        ///< m, of the Layout's Mean
  std::uint32_t version = 0;  ///< this streamer's pages have larger ones
};

/// A page that viewers may have.
struct OfferedPage {
  std::uint32_t page = 0, version = 0, structure = 0, count = 0;
  std::uint32_t object_id = 0;  ///< whose frame `bounds` is in
  std::uint8_t level = 0;
  bool frozen = false;
  PageBounds bounds;
  std::shared_ptr<const PageSurfels> surfels{};  ///< null where another streamer offers it
};

/// That a Gaussian which is not there is off, weighted by attribute.
inline constexpr float kAbsentSteps = 640;

/// Steps of pages, encoded once for all who hold them.
struct DeltaPacket {
  struct Step {
    std::uint32_t page = 0, base = 0, from_version = 0, version = 0;
    std::uint32_t count = 0;  ///< afterwards
    bool other_lanes = false;
    float steps = 0;  ///< that a Gaussian of the page is off without it, weighted by attribute; the mean
  };
  EncodedPacket packet;
  std::vector<Step> steps;
  std::vector<PageVersion> gone;
};

struct VisibilityPacket {
  EncodedPacket packet;
  std::vector<wire::SeenPage> pages;
};

/// A part of a page, or all of it.
struct PagePacket {
  EncodedPacket packet;
  std::uint32_t page = 0, version = 0, structure = 0;
};

/// What a tick has made.
struct StreamUpdate {
  std::vector<DeltaPacket> deltas;
  std::vector<std::uint32_t> gone;  ///< pages that end otherwise than in a delta
};

}  // namespace splatbus::stream
