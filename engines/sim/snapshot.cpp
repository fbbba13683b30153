#include "sim/snapshot.h"

#include <fmt/format.h>
#include <stb_image_write.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "sim/projection.h"
#include "sim/random.h"

namespace splatbus::sim {
namespace {

std::uint8_t byte(float value) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(value, 0.0F, 1.0F)));
}

/// Fills `picture`, RGB, from what `color_at` gives for each pixel.
template <class ColorAt>
cv::Mat map_pixels(const Pictures& pictures, ColorAt&& color_at) {
  cv::Mat picture(static_cast<int>(pictures.height), static_cast<int>(pictures.width), CV_8UC3);
  std::size_t pixel = 0;
  for (int y = 0; y < picture.rows; ++y) {
    for (int x = 0; x < picture.cols; ++x, ++pixel) picture.at<cv::Vec3b>(y, x) = color_at(pixel);
  }
  return picture;
}

cv::Vec3b grey_of_depth(float depth) {
  const std::uint8_t grey = depth > 0 ? byte(1 - depth / 8) : 0;
  return {grey, grey, grey};
}

}  // namespace

splatbus_camera parse_pose(const std::string& text, std::uint32_t width, std::uint32_t height) {
  std::vector<float> values;
  std::istringstream stream(text);
  std::string item;
  while (std::getline(stream, item, ',')) {
    std::size_t used = 0;
    float value = NAN;
    try {
      value = std::stof(item, &used);
    } catch (const std::exception&) {
      used = 0;
    }
    if (used == 0 || used != item.size() || !std::isfinite(value)) {
      throw std::runtime_error(fmt::format("pose '{}': '{}' is not a number", text, item));
    }
    values.push_back(value);
  }
  if (values.size() != 6 && values.size() != 7) {
    throw std::runtime_error(fmt::format(
        "pose '{}': wants 6 or 7 numbers (eye, target, vertical field of view), has {}", text, values.size()));
  }
  const float fov_deg = values.size() == 7 ? values[6] : 60;
  const glm::vec3 eye{values[0], values[1], values[2]};
  const glm::vec3 target{values[3], values[4], values[5]};
  if (fov_deg < 1 || fov_deg > 170)
    throw std::runtime_error(fmt::format("pose '{}': the field of view is 1 to 170 degrees", text));
  if (glm::distance(eye, target) < 1e-4F)
    throw std::runtime_error(fmt::format("pose '{}': eye and target are one point", text));
  return look_at(eye, target, width, height, fov_deg);
}

void write_snapshot(Renderer& renderer, const splatbus_camera& camera, const std::string& buffer,
                    const std::string& path) {
  cv::Mat rgb;
  if (buffer == "color" || buffer == "albedo") {
    const bool lit = buffer == "color";
    const Pictures& p = renderer.render(camera, lit ? SPLATBUS_BUFFER_COLOR : SPLATBUS_BUFFER_ALBEDO);
    const std::vector<std::uint8_t>& rgba = lit ? p.color : p.albedo;
    rgb = map_pixels(p, [&](std::size_t i) { return cv::Vec3b(rgba[4 * i], rgba[4 * i + 1], rgba[4 * i + 2]); });
  } else if (buffer == "normal") {
    const Pictures& p = renderer.render(camera, SPLATBUS_BUFFER_NORMAL);
    rgb = map_pixels(p, [&](std::size_t i) {
      const auto axis = [&](std::size_t c) { return byte(0.5F + 0.5F * p.normal[4 * i + c]); };
      return cv::Vec3b(axis(0), axis(1), axis(2));
    });
  } else if (buffer == "position" || buffer == "id") {
    const Pictures& p = renderer.render(camera, SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_OBJECT_ID);
    rgb = map_pixels(p, [&](std::size_t i) {
      const float* at = &p.world_position[4 * i];
      const std::uint32_t id = p.object_id[i];
      if (id == 0) return cv::Vec3b(0, 0, 0);
      const auto channel = [&](std::uint32_t c) {
        if (buffer == "id") return byte(0.2F + 0.8F * random01(7, id, c));
        return byte(at[c] / 2 - std::floor(at[c] / 2));
      };
      return cv::Vec3b(channel(0), channel(1), channel(2));
    });
  } else if (buffer == "depth") {
    const Pictures& p = renderer.render(camera, SPLATBUS_BUFFER_DEPTH);
    rgb = map_pixels(p, [&](std::size_t i) { return grey_of_depth(p.depth[i]); });
  } else if (buffer == "light_depth") {
    const Pictures& p =
        renderer.render(renderer.light_camera(0, camera.width, camera.height), SPLATBUS_BUFFER_LIGHT_DEPTH);
    rgb = map_pixels(p, [&](std::size_t i) { return grey_of_depth(p.light_depth[i]); });
  } else {
    throw std::runtime_error(fmt::format("snapshot: there is no buffer '{}'", buffer));
  }
  // Not OpenCV's codecs: they load a hundred libraries, on which an engine that starts anew would wait.
  if (stbi_write_png(path.c_str(), rgb.cols, rgb.rows, 3, rgb.data, static_cast<int>(rgb.step)) == 0) {
    throw std::runtime_error(fmt::format("snapshot: {} cannot be written", path));
  }
}

}  // namespace splatbus::sim
