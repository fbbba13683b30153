#include "device/buffer.h"
#include "device/parallel.h"
#include "trainer/sky_albedo.h"

namespace splatbus::trainer {

namespace {

constexpr int kMostRounding = 2;  // of a byte: the background, as another renderer rounds it

SPLATBUS_PORTABLE std::uint8_t byte_of(float linear) {
  return static_cast<std::uint8_t>(255 * math::srgb_from_linear(linear) + 0.5F);
}

/// An engine that leaves alpha at 0 has surfaces there, and these have an albedo.
SPLATBUS_PORTABLE bool is_sky(const std::uint8_t* color, const std::uint8_t* albedo) {
  return color[3] == 0 && albedo[0] == 0 && albedo[1] == 0 && albedo[2] == 0;
}

struct CountSky {
  const std::uint8_t* color;
  const std::uint8_t* albedo;
  std::uint8_t background[3];
  std::uint32_t* count;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint8_t* const pixel = color + std::size_t{4} * i;
    if (!is_sky(pixel, albedo + std::size_t{4} * i)) return;
    for (int c = 0; c < 3; ++c) {
      const int above = pixel[c] - background[c];
      if (above > kMostRounding || above < -kMostRounding) {
        device::atomic_add(count, 1U);
        return;
      }
    }
  }
};

struct AddSky {
  const std::uint8_t* color;
  float background[3];
  const std::uint32_t* count;
  std::uint8_t* albedo;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    if (*count == 0) return;
    const std::uint8_t* const lit = color + std::size_t{4} * i;
    std::uint8_t* const own = albedo + std::size_t{4} * i;
    const bool sky = is_sky(lit, own);
    if (lit[3] == 255 || (lit[3] == 0 && !sky)) return;
    const float behind = 1 - static_cast<float>(lit[3]) / 255;
    for (int c = 0; c < 3; ++c) {
      const float surface = math::linear_from_srgb(static_cast<float>(own[c]) / 255);
      own[c] = sky ? lit[c] : byte_of(surface + behind * background[c]);
    }
  }
};

}  // namespace

void add_sky_albedo(device::StreamView stream, const std::uint8_t* color, std::uint32_t pixels,
                    const math::Vec3& background, std::uint8_t* albedo) {
  device::Buffer<std::uint32_t> count(stream, 1);
  count.clear();
  const std::uint8_t shown[3] = {byte_of(background.x), byte_of(background.y), byte_of(background.z)};
  device::for_each_index(stream, pixels, CountSky{color, albedo, {shown[0], shown[1], shown[2]}, count.data()});
  // Pictures clip at 1, and so does what trains on them.
  const float behind[3] = {math::clamped(background.x, 0, 1), math::clamped(background.y, 0, 1),
                           math::clamped(background.z, 0, 1)};
  device::for_each_index(stream, pixels, AddSky{color, {behind[0], behind[1], behind[2]}, count.data(), albedo});
  stream.wait();
}

}  // namespace splatbus::trainer
