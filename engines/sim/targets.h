#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "gl/objects.h"

namespace splatbus::sim {

/// What the renderer draws into for pictures of one size.
struct Targets {
  std::uint32_t width = 0, height = 0;

  // Lit colour and albedo, linear, `supersample` times the size, multisampled; and their averages under the sRGB curve.
  GlTexture lit_samples, albedo_samples, shade_depth;
  GlFramebuffer shade;
  GlTexture color, albedo;
  GlFramebuffer resolve;

  // World position, normal, depth along the camera's z, object id.
  GlTexture position, normal, view_depth, object_id, geometry_depth;
  GlFramebuffer geometry;

  [[nodiscard]] std::size_t bytes(int supersample, int samples) const;
};

/// Makes targets when a size is first asked for, and keeps those used last, within a bound of memory.
class TargetCache {
 public:
  TargetCache(int supersample, int samples) : supersample_(supersample), samples_(samples) {}

  /// With the parts that are needed. Throws std::runtime_error naming the size when the driver cannot make them.
  Targets& get(std::uint32_t width, std::uint32_t height, bool shade, bool geometry);

 private:
  void add_shade(Targets& targets) const;
  static void add_geometry(Targets& targets);

  int supersample_, samples_;
  std::vector<std::unique_ptr<Targets>> targets_;  ///< last used first
};

}  // namespace splatbus::sim
