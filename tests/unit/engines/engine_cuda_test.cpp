// Frames that stay on the device. Skips where there is none.
#include <cuda_runtime_api.h>
#include <gmock/gmock.h>

#include <atomic>
#include <map>
#include <set>
#include <thread>

#include "bus/slab.h"
#include "render_scenes.h"
#include "sdk_fixture.h"
#include "sim/device_readback.h"
#include "sim/engine_loop.h"
#include "sim/toys.h"

namespace splatbus::engine_test {
namespace {

using testing::HasSubstr;

constexpr std::uint32_t kAll = SPLATBUS_BUFFER_COLOR | SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_NORMAL |
                               SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_DEPTH | SPLATBUS_BUFFER_OBJECT_ID;

bool has_device() {
  int count = 0;
  return cudaGetDeviceCount(&count) == cudaSuccess && count > 0;
}

/// Device memory with these bytes.
class DeviceBytes {
 public:
  explicit DeviceBytes(const std::vector<std::uint8_t>& bytes) {
    EXPECT_EQ(cudaMalloc(&data_, bytes.size()), cudaSuccess);
    EXPECT_EQ(cudaMemcpy(data_, bytes.data(), bytes.size(), cudaMemcpyHostToDevice), cudaSuccess);
  }
  ~DeviceBytes() { cudaFree(data_); }
  DeviceBytes(const DeviceBytes&) = delete;
  DeviceBytes& operator=(const DeviceBytes&) = delete;
  [[nodiscard]] void* data() const { return data_; }

 private:
  void* data_ = nullptr;
};

class CudaSdk : public SdkTest, public testing::WithParamInterface<splatbus_memory> {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
  }
};

TEST_P(CudaSdk, ImagesOfEitherMemoryReachTheReaders) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open("engine", GetParam());
  OwnedFrame owned(small_camera());
  for (std::size_t i = 0; i < owned.color.size(); ++i) owned.color[i] = static_cast<std::uint8_t>(3 * i);
  const DeviceBytes albedo(std::vector<std::uint8_t>(owned.color.rbegin(), owned.color.rend()));
  owned.images.push_back({SPLATBUS_BUFFER_ALBEDO, albedo.data(), owned.color.size(), SPLATBUS_MEMORY_CUDA});
  owned.refresh();
  ASSERT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK)
      << splatbus_engine_last_error(engine.get());

  const auto message = frames.receive(patience);
  ASSERT_TRUE(message.has_value());
  const auto kind = GetParam() == SPLATBUS_MEMORY_CUDA ? Device::Cuda : Device::Cpu;
  const auto pixels = [&](const char* name) {
    std::vector<std::uint8_t> bytes(owned.color.size());
    const auto tensor = message->tensor(name, bus::ElementType::U8, {6, 8, 4});
    EXPECT_TRUE(tensor && tensor->memory() == kind && tensor->copy(bytes.data())) << name;
    return bytes;
  };
  EXPECT_EQ(pixels("color"), owned.color);
  EXPECT_EQ(pixels("albedo"), std::vector<std::uint8_t>(owned.color.rbegin(), owned.color.rend()));
}

TEST_P(CudaSdk, WhatIsNoDeviceMemoryIsRefused) {
  const Engine engine = open("engine", GetParam());
  OwnedFrame owned(small_camera());
  owned.images[0].memory = SPLATBUS_MEMORY_CUDA;
  EXPECT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_THAT(splatbus_engine_last_error(engine.get()), HasSubstr("color: its data is not in CUDA memory"));
  owned.images[0].memory = SPLATBUS_MEMORY_HOST;
  EXPECT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK) << "it goes on";
}

TEST_P(CudaSdk, AnImageThatLeavesItsMemoryIsRefused) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open("engine", GetParam());
  OwnedFrame owned(small_camera());
  const DeviceBytes color(std::vector<std::uint8_t>(owned.color.size(), 7));
  const auto claim = [&](std::uint32_t width, std::uint32_t height) {
    owned.frame.camera.width = width;
    owned.frame.camera.height = height;
    owned.images[0] = {SPLATBUS_BUFFER_COLOR, color.data(), std::size_t{4} * width * height, SPLATBUS_MEMORY_CUDA};
  };
  claim(8192, 8192);  // far more than what else may lie behind it
  EXPECT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_THAT(splatbus_engine_last_error(engine.get()),
              testing::AllOf(HasSubstr("color"), HasSubstr("where 268435456 are said to be")));
  claim(8, 6);
  ASSERT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK)
      << splatbus_engine_last_error(engine.get());
  const auto message = frames.receive(patience);
  ASSERT_TRUE(message.has_value()) << "the next good frame is taken";
  std::vector<std::uint8_t> pixels(owned.color.size());
  const auto tensor = message->tensor("color");
  ASSERT_TRUE(tensor && tensor->copy(pixels.data()));
  EXPECT_EQ(pixels, std::vector<std::uint8_t>(pixels.size(), 7));
}

INSTANTIATE_TEST_SUITE_P(Rings, CudaSdk, testing::Values(SPLATBUS_MEMORY_HOST, SPLATBUS_MEMORY_CUDA),
                         [](const auto& memory) { return memory.param == SPLATBUS_MEMORY_CUDA ? "Cuda" : "Host"; });

/// Skips where OpenGL does not render on the CUDA device.
class CudaEngine : public SdkTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
    if (sim::shared_context()->is_software()) GTEST_SKIP() << "OpenGL renders in software";
  }
};

template <class T>
std::vector<T> host_copy(const std::vector<splatbus_image>& images, splatbus_buffer buffer) {
  for (const splatbus_image& image : images) {
    if (image.buffer != static_cast<std::uint32_t>(buffer)) continue;
    EXPECT_EQ(image.memory, std::uint32_t{SPLATBUS_MEMORY_CUDA});
    std::vector<T> values(image.bytes / sizeof(T));
    EXPECT_EQ(cudaMemcpy(values.data(), image.data, image.bytes, cudaMemcpyDeviceToHost), cudaSuccess);
    return values;
  }
  return {};
}

void expect_same(const sim::Pictures& host, const std::vector<splatbus_image>& images) {
  EXPECT_TRUE(host.color == host_copy<std::uint8_t>(images, SPLATBUS_BUFFER_COLOR));
  EXPECT_TRUE(host.albedo == host_copy<std::uint8_t>(images, SPLATBUS_BUFFER_ALBEDO));
  EXPECT_TRUE(host.world_position == host_copy<float>(images, SPLATBUS_BUFFER_WORLD_POSITION));
  EXPECT_TRUE(host.normal == host_copy<float>(images, SPLATBUS_BUFFER_NORMAL));
  EXPECT_TRUE(host.depth == host_copy<float>(images, SPLATBUS_BUFFER_DEPTH));
  EXPECT_TRUE(host.object_id == host_copy<std::uint32_t>(images, SPLATBUS_BUFFER_OBJECT_ID));
  EXPECT_TRUE(host.light_depth == host_copy<float>(images, SPLATBUS_BUFFER_LIGHT_DEPTH));
}

TEST_F(CudaEngine, SharedPicturesAreThoseOfTheHost) {
  sim::Renderer renderer(sim::shared_context(), sim::make_toys(1, true));
  renderer.set_time(0.7);
  const auto readback = sim::make_device_readback(*sim::shared_context(), "cuda");
  ASSERT_NE(readback, nullptr);
  // Sizes that grow, shrink and are no multiple of anything.
  for (const auto& [width, height] : {std::pair{64U, 48U}, {333U, 201U}, {31U, 7U}, {512U, 512U}, {64U, 48U}}) {
    const splatbus_camera camera = sim::look_at({2.4F, 1.6F, 2.1F}, {0, 0.25F, 0}, width, height, 60);
    const sim::Pictures host = renderer.render(camera, kAll);
    renderer.render(camera, kAll, *readback);
    ASSERT_EQ(readback->finish().size(), 1U);
    ASSERT_EQ(readback->finish().front().size(), 6U);
    expect_same(host, readback->finish().front());
    EXPECT_EQ(host.depth.size(), std::size_t{width} * height);
  }
  const splatbus_camera light = renderer.light_camera(0, 128, 96);
  for (const std::uint32_t buffers : {std::uint32_t{SPLATBUS_BUFFER_LIGHT_DEPTH},
                                      std::uint32_t{SPLATBUS_BUFFER_LIGHT_DEPTH | SPLATBUS_BUFFER_DEPTH}}) {
    const sim::Pictures host = renderer.render(light, buffers);
    renderer.render(light, buffers, *readback);
    expect_same(host, readback->finish().front());
    EXPECT_EQ(readback->finish().front().size(), buffers == SPLATBUS_BUFFER_LIGHT_DEPTH ? 1U : 2U);
  }
}

TEST_F(CudaEngine, CamerasThatAreWaitedForTogetherKeepTheirOwnPictures) {
  sim::Renderer renderer(sim::shared_context(), sim::make_toys(1, true));
  renderer.set_time(0.7);
  const auto readback = sim::make_device_readback(*sim::shared_context(), "cuda");
  ASSERT_NE(readback, nullptr);
  const auto camera = [](int k) {
    return sim::look_at({2.4F, 1.6F, 0.4F * static_cast<float>(k)}, {0, 0.25F, 0}, 64 + 8 * k, 48, 60);
  };
  for (const int count : {5, 2, 6}) {
    for (int k = 0; k < count; ++k) renderer.render(camera(k), kAll, *readback);
    // One that failed when it was nearly done.
    renderer.render(camera(7), kAll, *readback);
    readback->keep(static_cast<std::size_t>(count));
    const auto images = readback->finish();
    ASSERT_EQ(images.size(), static_cast<std::size_t>(count));
    for (int k = 0; k < count; ++k) expect_same(renderer.render(camera(k), kAll), images[static_cast<std::size_t>(k)]);
  }
}

/// Ten input and ten reference cameras.
std::vector<Request> burst(std::uint32_t first_id) {
  std::vector<Request> requests;
  for (std::uint32_t i = 0; i < 20; ++i) {
    const bool input = i < 10;
    const std::uint32_t size = input ? 256 : 512;
    const float angle = 0.6F * static_cast<float>(i);
    Request request{
        .camera = sim::look_at({3.4F * std::cos(angle), 1.6F, 3.4F * std::sin(angle)}, {0, 0.25F, 0}, size, size, 60),
        .buffers = wire::EngineBuffer::Color | wire::EngineBuffer::Albedo,
        .rate_hz = 0,
        .id = first_id + i + 1};
    if (input)
      request.buffers |= wire::EngineBuffer::WorldPosition | wire::EngineBuffer::Normal | wire::EngineBuffer::ObjectId;
    request.camera.id = first_id + i;
    request.camera.role = input ? SPLATBUS_ROLE_INPUT : SPLATBUS_ROLE_REFERENCE;
    requests.push_back(request);
  }
  return requests;
}

TEST_F(CudaEngine, ABurstOfNewCamerasIsOutAtOnce) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  std::atomic<bool> stop = false;
  std::atomic<bool> ready = false;
  const std::jthread engine_thread([&](const std::stop_token& ends) {
    const std::stop_callback stops(ends, [&] { stop = true; });
    const auto gl = std::make_shared<GlContext>();  // current on this thread
    sim::Renderer renderer(gl, sim::make_toys(1, false));
    const auto readback = sim::make_device_readback(*gl, "cuda");
    renderer.warm_up(readback.get());
    const sim::EngineHandle engine = sim::open_engine(directory_.address().text(), "engine", SPLATBUS_MEMORY_CUDA);
    ready = true;
    // The next frame comes after our patience.
    sim::EngineLoop(*engine, renderer, readback.get(), {.fps = 0.05}).run(stop);
  });
  ASSERT_TRUE(bus_test::eventually([&] { return ready.load(); }, std::chrono::seconds(60)));
  // The first burst also makes slabs and targets of these sizes; the second has them.
  for (const std::uint32_t first_id : {0U, 100U}) {
    const std::vector<Request> requests = burst(first_id);
    publish_requests(cameras, requests);
    std::set<std::uint64_t> answered;
    while (answered.size() < requests.size()) {
      const auto message = frames.receive(patience);
      ASSERT_TRUE(message.has_value()) << answered.size();
      if (!message->announces("color")) continue;  // what moves, before anybody asked for a picture
      const auto color = message->tensor("color");
      ASSERT_TRUE(color && color->memory() == Device::Cuda);
      answered.insert(message->root<wire::EngineFrame>().request_id());
    }
  }
  stop = true;
  publish_requests(cameras, burst(200));  // wakes the engine
}

}  // namespace
}  // namespace splatbus::engine_test
