#pragma once

#include <opencv2/core.hpp>

#include "gaussians/camera.h"
#include "scene_view.h"

namespace splatbus::cli {

/// Where a picture's surfaces see the sun: CV_8UC1, 255, or 0 in shadow; where there is no surface 255. `depth` is the
/// picture's, CV_32FC1, metres along the camera's z, 0 where there is no surface. `sun` are the sun's maps of the same
/// instant.
[[nodiscard]] cv::Mat lit_surfaces(const cv::Mat& depth, const Camera& camera, const relight::LightMaps& sun);

/// What lies within `reach` pixels (a square) of a place that came into or out of shadow between two pictures of one
/// camera, CV_8UC1, 255 or 0; single pixels do not count. `occupied` is where something moves in either picture: what
/// changes there is the object and not its shadow. The border is left out as in mask_of().
[[nodiscard]] cv::Mat moving_shadow_edges(const cv::Mat& lit_before, const cv::Mat& lit_now, const cv::Mat& occupied,
                                          int reach);

}  // namespace splatbus::cli
