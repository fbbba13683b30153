#pragma once

#include "gl/objects.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::sim {

/// A sky with clouds, and hills at the horizon, infinitely far away: what a pixel shows depends on its direction and
/// the light's background alone. It is no surface; pictures have no id, depth or coverage there.
class Sky {
 public:
  /// Fills colour attachment 0 of the framebuffer that is bound, over its whole viewport, in linear light. Other
  /// attachments have to be off. Of a pinhole camera.
  void draw(const splatbus_camera& camera, const splatbus_light& light);

 private:
  GlProgram program_;
  GlVertexArray no_vertices_;
};

}  // namespace splatbus::sim
