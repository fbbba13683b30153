#pragma once

#include <cuda_runtime_api.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "analytic_scene.h"
#include "bus/memory.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge::test {

/// Skips where there is no device.
class CudaTest : public testing::Test {
 protected:
  void SetUp() override {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
  }
};

/// One round's views and how to sample them.
struct RoundCase {
  std::vector<InputView> views;
  ObjectTransforms objects;
  SamplingOptions options;
};

inline std::vector<const InputView*> pointers_to(const std::vector<InputView>& views) {
  std::vector<const InputView*> pointers;
  for (const InputView& view : views) pointers.push_back(&view);
  return pointers;
}

/// The same views with their pictures on the device.
inline std::vector<InputView> on_device(const std::vector<InputView>& views) {
  std::vector<InputView> copies;
  for (const InputView& view : views) {
    bus::MemoryPool own(Device::Cuda);
    InputView& copy = copies.emplace_back(view);
    copy.allocate(own);
    copy.copy_pictures(view);
  }
  return copies;
}

/// An array of either kind of memory, on the host.
template <class T>
std::vector<T> on_host(const T* array, std::size_t count, Device kind) {
  std::vector<T> copy(count);
  bus::copy_memory(copy.data(), Device::Cpu, array, kind, count * sizeof(T));
  bus::finish_copies();
  return copy;
}

/// A dome around the analytic scene, as the bridge's.
inline RoundCase dome_round(int cameras, int size, std::size_t budget) {
  return {.views = AnalyticScene{}.render_all(small_dome(cameras, size)), .options = {.budget = budget}};
}

/// Every view sees the ball elsewhere; the round is in the last view's frame.
inline RoundCase moving_round() {
  RoundCase round{.options = {.budget = 5000}};
  const auto cameras = small_dome(6, 72);
  for (std::size_t v = 0; v < cameras.size(); ++v) {
    const auto step = static_cast<float>(v);
    AnalyticScene scene;
    scene.ball_centre += glm::vec3(0.04F * step, 0.01F * step, 0);
    InputView view = scene.render(cameras[v]);
    view.objects[AnalyticScene::kBall] = Rigid{glm::angleAxis(0.2F * step, glm::vec3(0, 0, 1)), scene.ball_centre};
    view.objects[AnalyticScene::kSheet] = Rigid{.translation = scene.sheet_centre};
    view.objects[77 + static_cast<std::uint32_t>(v)] = {};  // in no other view
    round.objects = view.objects;
    round.views.push_back(view);
  }
  return round;
}

/// Pixels of all sorts that no engine should send.
inline RoundCase garbage_round() {
  RoundCase round{.views = AnalyticScene{}.render_all(small_dome(5, 61)), .options = {.budget = 2000}};
  std::mt19937 random(3);
  const float values[] = {std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity(),
                          -std::numeric_limits<float>::infinity(),
                          3e38F,
                          -3e38F,
                          -1,
                          0,
                          1e-38F,
                          5e9F};
  for (InputView& view : round.views) {
    for (std::size_t i = 0; i < view.pixels(); i += 1 + random() % 5) {
      auto& pixel = random() % 2 == 0 ? view.position[i] : view.normal[i];
      pixel[static_cast<int>(random() % 4)] = values[random() % std::size(values)];
      view.color[i][3] = static_cast<std::uint8_t>(random());
    }
  }
  for (auto& position : round.views[3].position) position = glm::vec4(values[0]);
  return round;
}

/// Pictures that are not square, and smaller than a block of threads.
inline RoundCase odd_round(std::uint32_t width, std::uint32_t height) {
  RoundCase round{.options = {.cameras_per_surface = 2}};
  round.views = AnalyticScene{}.render_all({look_at({0, 2, 2}, {0, 0, 0}, width, height, 1),
                                            look_at({1, 2, 2}, {0, 0, 0}, width, height, 1),
                                            look_at({1, 2, 2}, {0, 0, 0}, width, height, 1)});
  for (InputView& view : round.views) view.light.background = {0.2F, 0.3F, 0.4F};
  return round;
}

}  // namespace splatbus::capture_bridge::test
