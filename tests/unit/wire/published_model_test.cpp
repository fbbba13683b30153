#include "wire/published_model.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <numeric>
#include <span>
#include <vector>

#include "bus/backend.h"
#include "bus/error.h"
#include "bus/memory.h"
#include "bus/publisher.h"
#include "bus/tensor_ring.h"
#include "bus_fixture.h"
#include "wire/model_generated.h"

namespace splatbus {
namespace {

constexpr std::uint32_t kCapacity = 32, kCount = 20, kChannels = 11 + 3;

/// Publishes a radiance model of degree 0 whose planes hold their own index, and reads it back.
class PublishedModels : public bus_test::BusTest, public testing::WithParamInterface<std::tuple<Device, Device>> {
 protected:
  void SetUp() override {
    const auto [published, wanted] = GetParam();
    const bool device = published == Device::Cuda || wanted == Device::Cuda;
    if (device && bus::choose_backend("auto") != Device::Cuda) GTEST_SKIP() << "no CUDA device";
  }

  /// The planes beyond `together` lie in a slab of their own.
  bus::Message publish(Device kind, float first_value, std::size_t together = SIZE_MAX) {
    std::vector<float> floats(std::size_t{kChannels} * kCapacity);
    std::iota(floats.begin(), floats.end(), first_value);
    std::vector<std::uint64_t> ids(kCapacity);
    std::iota(ids.begin(), ids.end(), 100);
    if (!ring_) ring_.emplace(maker_, "model", 1, 0, kind);
    const auto real = [&](const char* name, std::vector<std::uint32_t> shape) {
      return bus::TensorSource{.name = name, .shape = std::move(shape), .data = floats.data()};
    };
    const auto id = [&](const char* name, bus::ElementType type) {
      return bus::TensorSource{.name = name, .shape = {kCapacity}, .type = type, .data = ids.data()};
    };
    const std::vector<bus::TensorSource> sources{real("parameters", {kChannels, kCapacity}),
                                                 real("average", {kChannels, kCapacity}),
                                                 real("normal", {3, kCapacity}),
                                                 real("surface_point", {3, kCapacity}),
                                                 real("visibility", {kCapacity}),
                                                 id("object_id", bus::ElementType::U32),
                                                 id("flags", bus::ElementType::U32),
                                                 id("cell", bus::ElementType::U64),
                                                 id("gaussian_id", bus::ElementType::U64)};
    const std::span all(sources);
    std::vector<bus::OutgoingTensor> planes = ring_->write(all.first(std::min(together, all.size())));
    if (together < all.size()) {
      if (!apart_) apart_.emplace(maker_, "apart", 2, 0, kind);
      const auto others = apart_->write(all.subspan(together));
      planes.insert(planes.end(), others.begin(), others.end());
    }
    publisher_.publish(topics::kModelPublished, {.tensors = planes}, [&](auto& builder, auto header) {
      return wire::CreateModelPublished(builder, header, 1, kCount, kCapacity, wire::Appearance::Radiance, 0);
    });
    auto message = subscriber_.receive(bus_test::patience);
    if (!message) throw std::runtime_error("nothing arrived");
    return *message;
  }

  template <class T>
  static std::vector<T> fetch(Device kind, const T* from, std::size_t count) {
    std::vector<T> values(count);
    bus::copy_memory(values.data(), Device::Cpu, from, kind, count * sizeof(T));
    bus::finish_copies();
    return values;
  }

  std::shared_ptr<bus::Context> maker_ = connect("trainer"), reader_ = connect("reader");
  bus::Publisher publisher_{maker_};
  bus::Subscriber subscriber_{reader_, {"model/published"}};
  std::optional<bus::TensorRing> ring_, apart_;
};

TEST_P(PublishedModels, AreReadWhereTheReaderWantsThem) {
  const auto [published, wanted] = GetParam();
  auto model = PublishedModel::open(publish(published, 0), wanted);
  ASSERT_TRUE(model);
  const GaussiansView& view = model->average();
  ASSERT_EQ(view.count, kCount);
  for (const std::size_t channel : {std::size_t{0}, std::size_t{kChannels - 1}}) {
    std::vector<float> expected(kCount);
    std::iota(expected.begin(), expected.end(), static_cast<float>(channel * kCapacity));
    EXPECT_EQ(fetch(wanted, view.parameters + channel * view.stride, kCount), expected);
    EXPECT_EQ(fetch(wanted, model->live().parameters + channel * view.stride, kCount), expected);
  }
  std::vector<std::uint64_t> ids(kCount);
  std::iota(ids.begin(), ids.end(), 100);
  EXPECT_EQ(fetch(wanted, view.gaussian_id, kCount), ids);
  EXPECT_EQ(fetch(wanted, view.normal + 2 * view.stride, 1)[0], 2.0F * kCapacity);
  EXPECT_EQ(model->copied_bytes() > 0, published != wanted);
  EXPECT_TRUE(model->refresh());
}

TEST_P(PublishedModels, OneThatMovesOnIsNotValidAnyMore) {
  const auto [published, wanted] = GetParam();
  const auto message = publish(published, 0);
  auto model = PublishedModel::open(message, wanted, PublishedModel::Need::Average);
  ASSERT_TRUE(model);
  EXPECT_EQ(model->live().parameters, nullptr);
  (void)publish(published, 1000);
  EXPECT_FALSE(model->still_valid());
  EXPECT_FALSE(model->refresh());
  EXPECT_FALSE(PublishedModel::open(message, wanted));
}

TEST_P(PublishedModels, PlanesThatOneLockDoesNotGuardAreRefused) {
  const auto [published, wanted] = GetParam();
  // The last plane alone moves on unseen by whoever asks the first.
  const auto torn = publish(published, 0, 8);
  const auto open_torn = [&, kind = wanted] { (void)PublishedModel::open(torn, kind); };
  EXPECT_THAT(open_torn,
              testing::ThrowsMessage<bus::Error>(testing::AllOf(
                  testing::HasSubstr("trainer"), testing::HasSubstr("gaussian_id"), testing::HasSubstr("lock"))));
  EXPECT_TRUE(PublishedModel::open(publish(published, 0), wanted)) << "the next one is read";
}

constexpr auto kAnyKind = {Device::Cpu, Device::Cuda};
INSTANTIATE_TEST_SUITE_P(AllKinds, PublishedModels,
                         testing::Combine(testing::ValuesIn(kAnyKind), testing::ValuesIn(kAnyKind)));

}  // namespace
}  // namespace splatbus
