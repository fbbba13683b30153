#pragma once

#include <span>
#include <unordered_map>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "stream/stream_model.h"

namespace splatbus::streamer {

/// By page, how many pixels of the camera's picture it makes up about, where nearer pages hide what is behind them: of
/// a small picture of discs about the pages' surfels. Outside of it they have none. Pages without surfels are not in
/// it, and hide nothing; nor are those of objects that are not there.
[[nodiscard]] std::unordered_map<std::uint32_t, float> seen_areas_px2(std::span<const stream::OfferedPage> pages,
                                                                      const Camera& camera,
                                                                      const ObjectTransforms& objects);

}  // namespace splatbus::streamer
