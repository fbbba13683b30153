// A training step whose views and model change between steps.
#include <memory>
#include <utility>

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

TEST_F(RenewedViews, EveryStepHasTheTablesOfItsOwnViews) {
  // Far more steps than may be on their way, against as many that are waited for one by one.
  std::vector<float> trained[2];
  double losses[2] = {};
  for (const bool wait : {false, true}) {
    cuda::DeviceModel device;
    cuda::TrainStep train({.albedo_weight = 0.5F});
    start(train, device);
    cuda::TrainStep::Report sum;
    for (int k = 0; k < 24; ++k) {
      const cuda::TrainView now = view(2.0F * static_cast<float>(k % 3));
      train.step({&now, 1});
      if (!wait) continue;
      const auto done = train.finished(true);
      EXPECT_EQ(done.steps, 1U);
      EXPECT_NEAR(done.loss, train.losses()[0], 1e-6F);
      losses[1] += done.loss / 24;
    }
    if (!wait) {
      const auto done = train.finished(true);
      EXPECT_EQ(done.steps, 24U);
      EXPECT_EQ(done.views, 24U);
      EXPECT_GT(done.seconds, 0);
      losses[0] = done.loss;
    }
    trained[wait ? 1 : 0] = parameters(device, train);
  }
  EXPECT_NEAR(losses[0], losses[1], 1e-4);
  EXPECT_LT(difference(trained[1], trained[0]), 1e-4);
}

TEST_F(RenewedViews, AStepWithoutRoomForItsIntersectionsComesAgain) {
  cuda::DeviceModel device;
  cuda::TrainStep train({});
  start(train, device);
  const cuda::TrainView far = view(0.0F, 400.0F), near = view(0.0F);
  train.step({&far, 1});
  EXPECT_EQ(train.finished(true).steps, 1U);
  const std::vector<float> before = parameters(device, train);
  train.step({&near, 1});
  cudaStreamSynchronize(train.stream());
  EXPECT_EQ(parameters(device, train), before);
  const auto none = train.finished(false);
  EXPECT_EQ(none.steps, 0U);
  const auto done = train.finished(true);
  EXPECT_EQ(done.steps, 1U);
  EXPECT_EQ(done.views, 1U);
  EXPECT_NE(parameters(device, train), before);
}

TEST_F(RenewedViews, PicturesAreKeptUntilTheirStepIsDone) {
  cuda::DeviceModel device;
  cuda::TrainStep train({});
  start(train, device);
  auto kept = std::make_shared<int>(0);
  const std::weak_ptr<int> watched = kept;
  cuda::TrainView now = view(0.0F);
  now.keep = std::exchange(kept, nullptr);
  train.step({&now, 1});
  now = view(1.0F);
  EXPECT_FALSE(watched.expired());
  train.step({&now, 1});
  EXPECT_EQ(train.finished(true).steps, 2U);
  EXPECT_TRUE(watched.expired());
}

TEST_F(RenewedViews, PicturesOfSeveralSizesTakeTurns) {
  cuda::DeviceModel device;
  cuda::TrainStep train({.albedo_weight = 0.5F});
  start(train, device);
  const cuda::TrainView large = view(1.0F);
  cuda::TrainView small = view(2.0F);
  small.view.camera = look_at({0, 2, 5}, {0, 0, 0}, 24, 40, 1.0F);
  small.albedo = nullptr;
  const std::vector<cuda::TrainView> both = {large, small};
  train.step(both);
  EXPECT_EQ(train.last_views().back().view.camera.width, kCase.width) << "small pictures come first";
  const auto first = train.finished(true);
  EXPECT_EQ(first.steps, 1U);
  EXPECT_EQ(first.views, 2U);
  const std::size_t bytes = train.bytes();
  for (int k = 0; k < 6; ++k) train.step({k % 2 == 0 ? &large : &small, 1});
  const auto done = train.finished(true);
  EXPECT_EQ(train.bytes(), bytes);
  EXPECT_EQ(done.steps, 6U);
  EXPECT_TRUE(std::isfinite(done.loss));
}

TEST_F(RenewedViews, MoreViewsThanALaunchTakesAreOneStep) {
  cuda::DeviceModel device;
  cuda::TrainStep train({});
  start(train, device);
  const std::vector<cuda::TrainView> views(cuda::kMaxBatch + 3, view(1.0F));
  train.step(views);
  const auto done = train.finished(true);
  EXPECT_EQ(done.steps, 1U);
  EXPECT_EQ(done.views, views.size());
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
    for (int k = 0; k < 4; ++k) train.step({&now, 1});
    static_cast<void>(train.finished(true));
    cudaStreamSynchronize(train.stream());
    cuda::DeviceGaussians smaller = device.view();
    smaller.count -= 1;
    device::Buffer<std::uint32_t> from_to;
    cuda::ModelChange change;
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
      const std::uint32_t both[2] = {from, to};
      from_to.upload(both, 2, train.stream());
      change = {.ranges = {}, .fresh = {}, .from = from_to.data(), .to = from_to.data() + 1, .moves = 1};
    }
    train.follow_model(smaller, change);
    cudaStreamSynchronize(train.stream());
    for (int k = 0; k < 4; ++k) train.step({&now, 1});
    trained[moves ? 1 : 0] = parameters(device, train);
  }
  for (auto& values : trained) {  // the dead column's place holds whatever was left there
    for (std::size_t c = 0; c < 41; ++c) values[c * count + count - 1] = 0;
  }
  // A gradient near 0 has the sign of the order of additions: a tenth of a step of Adam's. Without its moments a column
  // is whole steps away.
  EXPECT_LT(difference(trained[1], trained[0]), 2e-4);
}

TEST_F(RenewedViews, ContributionsAreTheCpuBackends) {
  cuda::DeviceModel device;
  cuda::TrainStep train({});
  start(train, device);
  const std::vector<cuda::TrainView> views = {view(0.0F), view(2.0F)};
  train.forward(views);
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
