#include <gtest/gtest.h>

#include <cmath>

#include "raster/rasterizer.h"
#include "shown_replica.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

Light daylight() {
  Light light;
  light.ambient_sh[0] = glm::vec3(1.5F);
  light.sun_direction = glm::normalize(glm::vec3(0.3F, 1, 0.2F));
  light.sun_irradiance = glm::vec3(1.2F);
  light.background = glm::vec3(0.4F);
  return light;
}

// In display space, peak 1.
double psnr_db(const raster::Image& a, const raster::Image& b, bool linear) {
  const auto display = [&](float v) {
    v = std::clamp(v, 0.0F, 1.0F);
    return linear ? srgb_from_linear(v) : v;
  };
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += std::pow(display(a.data[i]) - display(b.data[i]), 2.0);
  return 10 * std::log10(static_cast<double>(a.data.size()) / sum);
}

class PageQuality : public testing::TestWithParam<Appearance> {};

TEST_P(PageQuality, ThePictureOfWhatArrivesIsThatOfWhatWasSent) {
  test::ToyServer server(31, 6000, GetParam());
  test::ShownReplica replica;
  test::join(server.stream, replica);
  const auto rasterizer = raster::make_cpu_rasterizer(1);
  const SceneState scene{daylight(), {}};
  for (const glm::vec3 eye : {glm::vec3(3, 2, 0), glm::vec3(0, 4, 0.1F), glm::vec3(-2, 0.6F, -2)}) {
    const Camera camera = look_at(eye, {0, 0, 0}, 128, 128, 1);
    raster::Render sent, arrived;
    rasterizer->render(server.model().view(), camera, scene, {}, sent);
    rasterizer->render(replica.view(), camera, scene, {}, arrived);
    EXPECT_GT(psnr_db(arrived.color, sent.color, GetParam() == Appearance::Transfer), 45);
  }
}

INSTANTIATE_TEST_SUITE_P(Appearances, PageQuality, testing::Values(Appearance::Transfer, Appearance::Radiance));

}  // namespace
}  // namespace splatbus::stream
