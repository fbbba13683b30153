#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <memory>
#include <random>
#include <vector>

#include "../../stream/toy_server.h"
#include "gl/context.h"
#include "viewer/gl/stage.h"
#include "viewer/painter.h"
#include "viewer/row_feed.h"

namespace splatbus::viewer::gl {
namespace {

constexpr std::uint32_t kWidth = 96, kHeight = 48;
constexpr float kFar_m = 3, kAside_m = 0.6F;

std::int64_t ms(std::int64_t count) {
  return count * 1'000'000;
}

Camera camera() {
  return look_at({0, 0, kFar_m}, {0, 0, 0}, kWidth, kHeight, 0.9F);
}

Batch many_rows(const std::vector<glm::vec3>& colors) {
  Batch batch;
  batch.whole = true;
  batch.object_ids = {kWorldFrame};
  batch.colors_ns = batch.scene_ns = ms(1000);
  std::mt19937 random(7);
  std::uniform_real_distribution<float> part(0, 1);
  for (std::size_t k = 0; k < colors.size(); ++k) {
    stream::GpuRecord record;
    for (float& x : record.mean) x = 2 * part(random) - 1;
    record.log_scale.fill(static_cast<std::int16_t>(-2500));
    record.opacity_object = static_cast<std::uint32_t>(50 + 200 * part(random));
    record.color = stream::shared_exponent_rgb(colors[k]);
    batch.update.rows.push_back(static_cast<std::uint32_t>(k));
    batch.update.records.push_back(record);
    batch.update.fades.push_back(kNoFade);
  }
  return batch;
}

std::vector<glm::vec3> any_colors(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> part(0, 1);
  std::vector<glm::vec3> colors(count);
  for (glm::vec3& color : colors) color = {part(random), part(random), part(random)};
  return colors;
}

std::vector<glm::vec3> mixed(std::vector<glm::vec3> from, const std::vector<glm::vec3>& to, float part) {
  for (std::size_t k = 0; k < from.size(); ++k) from[k] = glm::mix(from[k], to[k], part);
  return from;
}

/// `every`: of the rows.
Batch recolored(const std::vector<glm::vec3>& colors, std::int64_t of_ms, std::size_t every = 1) {
  Batch batch;
  batch.object_ids = {kWorldFrame};
  batch.colors_ns = batch.scene_ns = ms(of_ms);
  for (std::size_t k = 0; k < colors.size(); k += every) {
    batch.colors.rows.push_back(static_cast<std::uint32_t>(k));
    batch.colors.colors.push_back(stream::shared_exponent_rgb(colors[k]));
  }
  return batch;
}

class GlColors : public ::testing::TestWithParam<Draw> {
 protected:
  void expect_colors(std::int64_t shown_ms, const std::vector<glm::vec3>& colors) {
    stage_.advance(ms(shown_ms));
    SCOPED_TRACE(shown_ms);
    expect_colors(colors);
  }
  void expect_colors(const std::vector<glm::vec3>& colors) {
    Stage expected(GetParam());
    expected.add(many_rows(colors));
    const Picture a = stage_.capture(camera(), scene_, kSettled_s), b = expected.capture(camera(), scene_, kSettled_s);
    int most = 0;
    for (std::size_t k = 0; k < a.rgba.size(); ++k) most = std::max(most, std::abs(int{a.rgba[k]} - int{b.rgba[k]}));
    EXPECT_LE(most, 2);
  }

  GlContext context_;
  Stage stage_{GetParam()};
  SceneState scene_;
};

TEST_P(GlColors, AreBetweenThoseOfTheSceneBeforeAndTheNext) {
  constexpr std::size_t kRows = 300;
  const std::vector<glm::vec3> first = any_colors(kRows, 1), second = any_colors(kRows, 2),
                               paint = any_colors(kRows, 3);
  std::vector<glm::vec3> third = second;
  for (std::size_t k = 0; k < kRows; k += 3) third[k] = paint[k];
  stage_.add(many_rows(first));
  expect_colors(980, first);
  const std::size_t before = stage_.uploaded().bytes;
  stage_.add(recolored(second, 1100));
  expect_colors(990, first);
  EXPECT_EQ(stage_.uploaded().bytes, before) << "they wait";
  EXPECT_TRUE(stage_.recoloring());
  expect_colors(1000, first);
  expect_colors(1050, mixed(first, second, 0.5F));
  stage_.add(recolored(paint, 1200, 3));
  expect_colors(1075, mixed(first, second, 0.75F));
  expect_colors(1100, second);
  expect_colors(1150, mixed(second, third, 0.5F));
  EXPECT_TRUE(stage_.recoloring());
  expect_colors(1200, third);
  EXPECT_FALSE(stage_.recoloring());
  EXPECT_EQ(stage_.uploaded().bytes - before, 8 * (kRows + kRows / 3));
}

TEST_P(GlColors, OfRowsThatAreWrittenMeanwhileAreTheirs) {
  constexpr std::size_t kRows = 300;
  const std::vector<glm::vec3> first = any_colors(kRows, 1), second = any_colors(kRows, 2),
                               paint = any_colors(kRows, 3);
  const Batch all = many_rows(paint);
  stage_.add(many_rows(first));
  stage_.advance(ms(980));
  stage_.add(recolored(second, 1100));
  expect_colors(1040, mixed(first, second, 0.4F));
  Batch written;  // one so far away that all have to be moved
  written.object_ids = {kWorldFrame};
  written.colors_ns = written.scene_ns = ms(1100);
  for (std::size_t k = 1; k < kRows; k += 7) {
    written.update.rows.push_back(static_cast<std::uint32_t>(k));
    written.update.records.push_back(all.update.records[k]);
    written.update.fades.push_back(kNoFade);
  }
  written.update.rows.push_back(100'000);
  written.update.records.emplace_back();
  written.update.fades.push_back(kNoFade);
  stage_.add(written);
  std::vector<glm::vec3> expected = mixed(first, second, 0.5F);
  for (std::size_t k = 1; k < kRows; k += 7) expected[k] = paint[k];
  expect_colors(1050, expected);
}

TEST_P(GlColors, AreTheNewestWhereNothingIsPlayedOut) {
  const std::vector<glm::vec3> first = any_colors(100, 1), second = any_colors(100, 2);
  stage_.add(many_rows(first));
  stage_.add(recolored(second, 1100));
  expect_colors(second);
}

INSTANTIATE_TEST_SUITE_P(Each, GlColors, ::testing::Values(Draw::Quads, Draw::Tiles),
                         [](const auto& instance) { return instance.param == Draw::Tiles ? "Tiles" : "Quads"; });

/// Two side by side, in grey.
class GlTwoColors : public ::testing::Test {
 protected:
  GlTwoColors() {
    Batch batch = many_rows({glm::vec3(0.1F), glm::vec3(0.1F)});
    for (std::size_t k = 0; k < 2; ++k) batch.update.records[k] = record(k, 0.1F);
    stage_.add(batch);
    stage_.advance(ms(980));
  }

  static stream::GpuRecord record(std::size_t row, float grey) {
    stream::GpuRecord record;
    record.mean = {row == 0 ? -kAside_m : kAside_m, 0, 0};
    record.log_scale.fill(-1000);  // 0.38 m
    record.opacity_object = 255;
    record.color = stream::shared_exponent_rgb(glm::vec3(grey));
    return record;
  }
  void add(const std::map<std::uint32_t, float>& greys, std::int64_t of_ms, std::int64_t scene_ms) {
    Batch batch;
    batch.object_ids = {kWorldFrame};
    batch.colors_ns = ms(of_ms);
    batch.scene_ns = ms(scene_ms);
    for (const auto& [row, grey] : greys) {
      batch.colors.rows.push_back(row);
      batch.colors.colors.push_back(stream::shared_exponent_rgb(glm::vec3(grey)));
    }
    stage_.add(batch);
  }
  void add(const std::map<std::uint32_t, float>& greys, std::int64_t of_ms) { add(greys, of_ms, of_ms); }
  void write(std::size_t row, float grey) {
    Batch batch;
    batch.object_ids = {kWorldFrame};
    batch.update = {.rows = {static_cast<std::uint32_t>(row)}, .records = {record(row, grey)}, .fades = {kNoFade}};
    batch.colors_ns = batch.scene_ns = ms(1100);
    stage_.add(batch);
  }
  float at(std::int64_t shown_ms, std::size_t row = 0) {
    stage_.advance(ms(shown_ms));
    const Picture picture = stage_.capture(camera(), {}, kSettled_s);
    const Camera from = camera();
    const auto x = static_cast<std::size_t>(from.cx + from.fx * (row == 0 ? -kAside_m : kAside_m) / kFar_m);
    const float value = static_cast<float>(picture.rgba[4UL * (std::size_t{kHeight} / 2 * kWidth + x)]) / 255;
    return value <= 0.04045F ? value / 12.92F : std::pow((value + 0.055F) / 1.055F, 2.4F);
  }

  static constexpr float kNear = 0.012F;
  GlContext context_;
  Stage stage_{Draw::Quads};
};

TEST_F(GlTwoColors, ThatComeLateDoNotJump) {
  ASSERT_NEAR(at(1040), 0.1, kNear);
  add({{0, 0.5F}}, 1100);
  EXPECT_NEAR(at(1040), 0.1, kNear);
  EXPECT_NEAR(at(1070), 0.3, kNear);
  EXPECT_NEAR(at(1100), 0.5, kNear);
}

TEST_F(GlTwoColors, OfARowThatWasWrittenAreNotThoseThatWaitedBefore) {
  add({{0, 0.5F}, {1, 0.5F}}, 1100);
  write(0, 0.4F);
  EXPECT_NEAR(at(1050), 0.4, kNear);
  EXPECT_NEAR(at(1050, 1), 0.3, kNear);
  EXPECT_NEAR(at(1100), 0.4, kNear);
  add({{0, 0.2F}}, 1200);
  EXPECT_NEAR(at(1200), 0.2, kNear);
}

TEST_F(GlTwoColors, OfShadowsOfAnEarlierTimeAreNotUndone) {
  add({{0, 0.5F}, {1, 0.5F}}, 1100);
  add({{0, 0.02F}}, 1010, 1100);
  EXPECT_NEAR(at(1005), 0.06, kNear);
  EXPECT_NEAR(at(1055), 0.02, kNear);
  EXPECT_NEAR(at(1055, 1), 0.3, kNear);
  EXPECT_NEAR(at(1100), 0.02, kNear);
}

TEST_F(GlTwoColors, OfOneSceneMayComeInParts) {
  add({{0, 0.5F}}, 1100);
  EXPECT_NEAR(at(1050), 0.3, kNear);
  add({{1, 0.5F}}, 1100);
  EXPECT_NEAR(at(1050, 1), 0.3, kNear);
  EXPECT_NEAR(at(1100, 1), 0.5, kNear);
}

TEST_F(GlTwoColors, AreNotWaitedForWithoutAClockNorOfAnotherEngine) {
  add({{0, 0.5F}}, 0, 1000);
  EXPECT_NEAR(at(985), 0.5, kNear);
  add({{0, 0.3F}, {1, 0.3F}}, 1100);
  add({{0, 0.35F}}, 400);
  EXPECT_NEAR(at(400), 0.35, kNear);
  EXPECT_NEAR(at(400, 1), 0.3, kNear) << "what waited for another time has come";
  add({{0, 0.15F}}, 500);
  EXPECT_NEAR(at(400), 0.35, kNear);
  EXPECT_NEAR(at(450), 0.25, kNear) << "the clock is the other's";
}

TEST_F(GlTwoColors, DoNotWaitInAnyNumber) {
  for (int k = 1; k <= 100; ++k) add({{0, 0.2F}, {1, 0.3F}}, 1000 + k);
  const std::size_t before = stage_.uploaded().rows;
  static_cast<void>(at(990));
  EXPECT_GE(stage_.uploaded().rows - before, 2 * (100 - ColorPlayout::kMostWaiting));
}

TEST_F(GlTwoColors, AreOfNoLaterSceneThanTheNewest) {
  add({{0, 0.5F}}, 90'000, 1100);
  EXPECT_NEAR(at(1050), 0.3, kNear);
  EXPECT_NEAR(at(1100), 0.5, kNear);
  EXPECT_FALSE(stage_.recoloring());
  Batch anew = many_rows({glm::vec3(0.1F), glm::vec3(0.1F)});
  for (std::size_t k = 0; k < 2; ++k) anew.update.records[k] = record(k, 0.1F);
  anew.colors_ns = ms(90'000);
  anew.scene_ns = ms(1200);
  stage_.add(anew);
  add({{0, 0.5F}}, 1300);
  EXPECT_NEAR(at(1200), 0.1, kNear);
  EXPECT_NEAR(at(1250), 0.3, kNear);
}

TEST(GlWaitingColors, AreOfNoMoreRowsThanThatInAll) {
  const GlContext context;
  RowStore rows;
  rows.apply(many_rows({glm::vec3(0.1F), glm::vec3(0.1F)}).update);
  ColorPlayout playout(5);
  playout.restart(ms(1000));
  playout.advance(ms(980), rows);
  const std::size_t before = rows.uploaded().rows;
  for (int k = 1; k <= 5; ++k) {
    playout.add(recolored({glm::vec3(0.2F), glm::vec3(0.3F)}, 1000 + k).colors, ms(1000 + k), ms(1000 + k));
  }
  playout.advance(ms(990), rows);
  EXPECT_EQ(rows.uploaded().rows - before, 6) << "four of ten wait on";
  playout.advance(ms(1005), rows);
  EXPECT_EQ(rows.uploaded().rows - before, 10);
}

TEST(GlPainterColors, AreThoseOfTheTimeThatIsPlayedOut) {
  stream::test::ToyServer server(4, 300);
  stream::Replica replica;
  RowFeed feed(replica, false);
  const std::unique_ptr<Painter> painter = make_gl_painter(false, Draw::Quads);
  const auto light = [&](float irradiance, std::int64_t captured_ms) {
    server.scene.light.sun_irradiance = glm::vec3(irradiance);
    ++server.scene.version;
    stream::test::send(
        server.stream.take_scene(server.scene, {.frame = server.scene.version, .capture_ns = ms(captured_ms)}),
        replica);
  };
  const auto take = [&] {
    Shown shown;
    shown.batches.push_back(feed.take(1));
    ASSERT_TRUE(shown.batches.front());
    painter->take(shown);
  };
  const auto brightness = [&](std::int64_t shown_ms) {
    painter->advance(ms(shown_ms));
    return cv::mean(painter->draw(look_at({0, 1, 2}, {0, 0, 0}, 64, 64, 0.9F), replica.scene()))[1];
  };
  stream::test::join(server.stream, replica);
  light(0.1F, 1000);
  take();
  const double dark = brightness(990);
  light(1, 1100);
  take();
  EXPECT_EQ(brightness(1000), dark);
  EXPECT_TRUE(painter->settles(kSettled_s)) << "the next picture is another";
  const double between = brightness(1050), bright = brightness(1100);
  EXPECT_GT(between, dark + 5);
  EXPECT_LT(between, bright - 5);
  EXPECT_FALSE(painter->settles(kSettled_s));
}

}  // namespace
}  // namespace splatbus::viewer::gl
