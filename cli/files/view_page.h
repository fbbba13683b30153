#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <string>

#include "splats/file.h"

namespace splatbus::cli {

/// From where a page is to be seen first, in the world, metres.
struct Viewpoint {
  glm::vec3 eye{0}, target{0};
};

struct PageOptions {
  std::string path;                   ///< as the file was named
  std::optional<std::uint16_t> port;  ///< 0: any free one; none: the usual one, or another where that is taken
  std::optional<Viewpoint> from;      ///< none: where it sees everything
  glm::vec3 background{0};            ///< linear
};

/// The part of the page's address behind #, without that: the camera at `from`. Throws std::runtime_error where that
/// looks nowhere.
[[nodiscard]] std::string view_fragment(const Viewpoint& from);

/// Serves a file's Gaussians to browsers of this machine, by a bus, a streamer and a gateway of its own, prints the
/// address, and returns 0 when the user ends it. Throws std::runtime_error where there is nothing to show, the port
/// cannot be had, this build has no page, or a process fails for good.
int view_in_page(splats::SplatFile file, const PageOptions& options);

}  // namespace splatbus::cli
