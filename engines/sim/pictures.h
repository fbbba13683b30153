#pragma once

#include <cstdint>
#include <vector>

#include "sdk/splatbus_engine.h"
#include "sim/readback.h"

namespace splatbus::sim {

/// One camera's buffers, row 0 on top, layouts of splatbus_buffer. Those that were not asked for are empty.
struct Pictures {
  std::uint32_t width = 0, height = 0;
  std::vector<std::uint8_t> color, albedo;    ///< [h, w, 4]; albedo is over black
  std::vector<float> world_position, normal;  ///< [h, w, 4]
  std::vector<float> depth, light_depth;      ///< [h, w]
  std::vector<std::uint32_t> object_id;       ///< [h, w]
};

/// Those that are not empty, as the SDK takes them: `pictures` outlive them.
[[nodiscard]] std::vector<splatbus_image> images_of(const Pictures& pictures);

/// Takes pictures into the host's memory.
class HostReadback final : public Readback {
 public:
  /// `pictures` outlive it, and are those of the last camera.
  explicit HostReadback(Pictures& pictures) : pictures_(pictures) {}

  void begin(std::uint32_t width, std::uint32_t height, std::size_t bytes) override;
  void take(const DrawnPicture& drawn) override;

 private:
  Pictures& pictures_;
};

}  // namespace splatbus::sim
