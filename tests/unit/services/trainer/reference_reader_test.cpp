// What is made of an engine's pictures before anything trains on them.
#include "trainer/reference_reader.h"

#include <gtest/gtest.h>

#include <atomic>
#include <vector>

#include "bus/error.h"
#include "trainer_fixture.h"

namespace splatbus::trainer {
namespace {

class ReferenceReaderTest : public TrainerTest {};

TEST_F(ReferenceReaderTest, WhatIsNotToBeModelledIsMaskedInPictures) {
  TrainingView view = *SyntheticScene(10, 1).views().front();
  view.scene.objects[0xFFFFFFFF].modelled = false;
  view.scene.objects[0x80000000].modelled = false;
  view.scene.objects[5];
  std::vector<std::uint32_t> ids(view.depth.size());
  std::vector<std::uint8_t> expected(ids.size());
  const std::uint32_t of[] = {0, 5, 0x80000000, 0x7FFFFFFF, 0xFFFFFFFF, 0xFFFFFFFE};
  for (std::size_t i = 0; i < ids.size(); ++i) {
    ids[i] = of[i * i % 6];
    expected[i] = ids[i] == 0x80000000 || ids[i] == 0xFFFFFFFF ? 255 : 0;
  }
  std::atomic<std::uint64_t> host_bytes{0};
  ReferenceReader reader(Device::Cpu, 1 << 20, 1 << 20, host_bytes);
  bus::Subscriber references(connect("reader"), {"capture/reference"});
  bus_test::meet(publisher_, references);
  const auto next = [&] { return references.receive(bus_test::patience).value(); };
  publish_view(view, false, 0, ids);
  const auto masked = reader.read(next(), true).view;
  EXPECT_EQ(std::vector<std::uint8_t>(masked->mask.data(), masked->mask.data() + masked->mask.size()), expected);
  publish_view(view);
  EXPECT_THROW((void)reader.read(next(), true), bus::Error) << "it does not say where they show";
  view.scene.objects.erase(0xFFFFFFFF);
  view.scene.objects.erase(0x80000000);
  publish_view(view, false, 0, ids);
  EXPECT_TRUE(reader.read(next(), true).view->mask.empty());
}

TEST_F(ReferenceReaderTest, TheFarFieldShowsInAlbedoPictures) {
  TrainingView view = *SyntheticScene(10, 1).views().front();
  ASSERT_FALSE(view.albedo.empty());
  view.scene.light.background = glm::vec3(0);
  std::vector<std::uint8_t> color(view.color.size(), 255), albedo(color.size(), 100);
  for (std::size_t i = 0; i < color.size() / 2; ++i) {  // sky
    color[i] = i % 4 == 3 ? 0 : 50;
    albedo[i] = 0;
  }
  view.color = Pixels<std::uint8_t>(std::vector<std::uint8_t>(color));
  view.albedo = Pixels<std::uint8_t>(std::vector<std::uint8_t>(albedo));
  std::atomic<std::uint64_t> host_bytes{0};
  ReferenceReader reader(Device::Cpu, 1 << 20, 1 << 20, host_bytes);
  bus::Subscriber references(connect("reader"), {"capture/reference"});
  bus_test::meet(publisher_, references);
  const auto next = [&] { return reader.read(references.receive(bus_test::patience).value(), true).view; };
  publish_view(view);
  const auto without = next();
  EXPECT_EQ(std::vector<std::uint8_t>(without->albedo.data(), without->albedo.data() + albedo.size()), albedo);
  view.scene.objects[kFarFieldFrame];
  publish_view(view);
  const auto with = next();
  for (std::size_t i = 0; i < albedo.size(); ++i) {
    if (i % 4 == 3) continue;
    ASSERT_EQ(with->albedo[i], i < albedo.size() / 2 ? 50 : 100) << i;
  }
}

}  // namespace
}  // namespace splatbus::trainer
