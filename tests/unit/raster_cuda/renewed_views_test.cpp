// A training step whose views and model change between steps.
#include "cuda_scenes.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::testing {
namespace {

constexpr Case kCase{"", {Appearance::Transfer, 0}, 1500, 48, 40, true, true, -2.5F};

class RenewedViews : public CudaTest {
 protected:
  void SetUp() override {
    CudaTest::SetUp();
    if (IsSkipped()) return;
    std::mt19937 random(5);
    std::vector<std::uint8_t> target(std::size_t{4} * kCase.width * kCase.height);
    for (auto& value : target) value = static_cast<std::uint8_t>(random() % 256);
    picture_.upload(target.data(), target.size(), nullptr);
    cudaDeviceSynchronize();
  }

  [[nodiscard]] cuda::TrainView view(float angle, float distance = 5.0F) const {
    const glm::vec3 eye(distance * std::cos(angle), 0.3F * distance, distance * std::sin(angle));
    return {.view = {.camera = look_at(eye, {0, 0, 0}, kCase.width, kCase.height, 1.0F), .scene = &scene_},
            .color = picture_.data(),
            .albedo = picture_.data()};
  }

  void start(cuda::TrainStep& train, cuda::DeviceModel& device) const {
    device.upload(model_.view(), nullptr);
    cudaDeviceSynchronize();
    train.set_model(device.view());
    train.set_learning_rates(std::vector<float>(41, 1e-3F));
  }

  static std::vector<float> parameters(const cuda::DeviceModel& device, const cuda::TrainStep& train) {
    std::vector<float> values(41 * static_cast<std::size_t>(device.view().count));
    device.download_parameters(values.data(), train.stream());
    cudaStreamSynchronize(train.stream());
    return values;
  }

  static double difference(const std::vector<float>& a, const std::vector<float>& b) {
    double off = 0, norm = 0;
    for (std::size_t k = 0; k < a.size(); ++k) {
      off += std::pow(a[k] - b[k], 2);
      norm += std::pow(b[k], 2);
    }
    return std::sqrt(off / norm);
  }

  GaussiansBuffer model_ = random_model(kCase, 3);
  SceneState scene_ = random_scene(true);
  device::Buffer<std::uint8_t> picture_;
};

TEST_F(RenewedViews, TrainAsGroupsOfTheirOwnDo) {
  std::vector<float> trained[2];
  for (const bool renew : {false, true}) {
    cuda::DeviceModel device;
    cuda::TrainStep train({.albedo_weight = 0.5F});
    start(train, device);
    std::vector<std::size_t> groups;
    for (int k = 0; k < 9; ++k) {
      const cuda::TrainView now = view(2.0F * static_cast<float>(k % 3));
      if (renew && k > 0) {
        train.renew_group(0, {&now, 1});
      } else if (k < 3) {
        groups.push_back(train.add_group({&now, 1}));
      }
      train.step(renew ? 0 : groups[static_cast<std::size_t>(k % 3)]);
    }
    const auto reports = train.finished(true);
    EXPECT_EQ(reports.size(), 9U);
    for (const auto& report : reports) EXPECT_TRUE(report.changed);
    EXPECT_NEAR(reports.back().loss, train.losses()[0], 1e-6F);
    trained[renew ? 1 : 0] = parameters(device, train);
  }
  EXPECT_LT(difference(trained[1], trained[0]), 1e-4);
}

TEST_F(RenewedViews, AStepWhoseListsDoNotFitChangesNothing) {
  cuda::DeviceModel device;
  cuda::TrainStep train({});
  start(train, device);
  const cuda::TrainView far = view(0.0F, 400.0F), near = view(0.0F);
  train.add_group({&far, 1});
  train.renew_group(0, {&far, 1});
  train.step(0);
  ASSERT_TRUE(train.finished(true).at(0).changed);
  const std::vector<float> before = parameters(device, train);
  train.renew_group(0, {&near, 1});
  train.step(0);
  EXPECT_FALSE(train.finished(true).at(0).changed);
  EXPECT_EQ(parameters(device, train), before);
  train.step(0);
  EXPECT_TRUE(train.finished(true).at(0).changed);
  EXPECT_NE(parameters(device, train), before);
}

TEST_F(RenewedViews, PicturesOfSeveralSizesTakeTurns) {
  cuda::DeviceModel device;
  cuda::TrainStep train({.albedo_weight = 0.5F});
  start(train, device);
  const cuda::TrainView large = view(1.0F);
  cuda::TrainView small = view(2.0F);
  small.view.camera = look_at({0, 2, 5}, {0, 0, 0}, 24, 40, 1.0F);
  small.albedo = nullptr;
  const std::size_t of_large = train.add_group({&large, 1}), of_small = train.add_group({&small, 1});
  train.step(of_large);
  train.step(of_small);
  const std::size_t bytes = train.bytes();
  for (int k = 0; k < 6; ++k) train.step(k % 2 == 0 ? of_large : of_small);
  EXPECT_EQ(train.bytes(), bytes);
  for (const auto& report : train.finished(true)) {
    EXPECT_TRUE(report.changed);
    EXPECT_TRUE(std::isfinite(report.loss));
  }
}

TEST_F(RenewedViews, ColumnsThatMoveTakeTheirMomentsWithThem) {
  // The last column dies, or one in the middle does and the last takes its place: the others train alike.
  const auto count = static_cast<std::size_t>(kCase.count), hole = count / 2;
  std::vector<float> trained[2];
  for (const bool moves : {false, true}) {
    GaussiansBuffer model = model_;
    const auto swap_columns = [&](auto& planes, std::size_t a, std::size_t b) {
      for (std::size_t c = 0; c < planes.size() / model.stride(); ++c) {
        std::swap(planes[c * model.stride() + a], planes[c * model.stride() + b]);
      }
    };
    const auto swap_all = [&](std::size_t a, std::size_t b) {
      swap_columns(model.parameters, a, b);
      swap_columns(model.normal, a, b);
      swap_columns(model.visibility, a, b);
      swap_columns(model.object_id, a, b);
      swap_columns(model.flags, a, b);
    };
    if (moves) swap_all(hole, count - 1);
    cuda::DeviceModel device;
    device.upload(model.view(), nullptr);
    cudaDeviceSynchronize();
    cuda::TrainStep train({});
    train.set_model(device.view());
    train.set_learning_rates(std::vector<float>(41, 1e-3F));
    const cuda::TrainView now = view(1.0F);
    train.add_group({&now, 1});
    for (int k = 0; k < 4; ++k) train.step(0);
    static_cast<void>(train.finished(true));
    cudaStreamSynchronize(train.stream());
    cuda::DeviceGaussians smaller = device.view();
    smaller.count -= 1;
    if (moves) {
      const auto from = static_cast<std::uint32_t>(count - 1), to = static_cast<std::uint32_t>(hole);
      for (std::size_t c = 0; c < 41; ++c) {
        cudaMemcpy(smaller.parameters + c * count + to, smaller.parameters + c * count + from, sizeof(float),
                   cudaMemcpyDeviceToDevice);
      }
      const auto copy = [&](const auto* plane, std::size_t planes) {
        auto* const writable = const_cast<std::remove_const_t<std::remove_pointer_t<decltype(plane)>>*>(plane);
        for (std::size_t c = 0; c < planes; ++c) {
          cudaMemcpy(writable + c * count + to, plane + c * count + from, sizeof(*plane), cudaMemcpyDeviceToDevice);
        }
      };
      copy(smaller.normal, 3);
      copy(smaller.visibility, 1);
      copy(smaller.object_id, 1);
      copy(smaller.flags, 1);
      device::Buffer<std::uint32_t> from_to;
      const std::uint32_t both[2] = {from, to};
      from_to.upload(both, 2, train.stream());
      train.move_columns(from_to.data(), from_to.data() + 1, 1);
      cudaStreamSynchronize(train.stream());
    }
    train.follow_model(smaller);
    for (int k = 0; k < 4; ++k) train.step(0);
    trained[moves ? 1 : 0] = parameters(device, train);
  }
  for (auto& values : trained) {  // the dead column's place holds whatever was left there
    for (std::size_t c = 0; c < 41; ++c) values[c * count + count - 1] = 0;
  }
  EXPECT_LT(difference(trained[1], trained[0]), 1e-4);
}

TEST_F(RenewedViews, ContributionsAreTheCpuBackends) {
  cuda::DeviceModel device;
  cuda::TrainStep train({});
  start(train, device);
  const std::vector<cuda::TrainView> views = {view(0.0F), view(2.0F)};
  train.add_group(views);
  train.forward(0);
  device::Buffer<float> contribution(model_.count());
  for (int v = 0; v < 2; ++v) {
    contribution.clear(train.stream());
    cuda::launch_contribution(device.view(), train.workspace(), v, contribution.data(), train.stream());
    std::vector<float> actual(model_.count());
    contribution.download(actual.data(), actual.size(), train.stream());
    cudaStreamSynchronize(train.stream());
    const auto cpu = make_cpu_rasterizer(1);
    Render render;
    cpu->forward(model_.view(), views[static_cast<std::size_t>(v)].view.camera, scene_, {}, render);
    RenderGradient gradient;
    gradient.color = Image(kCase.width, kCase.height, 3);
    ParameterGradient out;
    out.clear(model_.view());
    cpu->backward(gradient, out);
    std::size_t contributing = 0;
    for (std::size_t i = 0; i < actual.size(); ++i) {
      if ((model_.flags[i] & kFrozen) == 0) {
        EXPECT_NEAR(actual[i], out.contribution[i], 2e-3F) << i;
      }
      contributing += actual[i] > 0 ? 1 : 0;
    }
    EXPECT_GT(contributing, model_.count() / 10);
  }
}

}  // namespace
}  // namespace splatbus::raster::testing
