#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "gl/context.h"
#include "viewer/gl/flight.h"
#include "viewer/gl/shaders.h"
#include "viewer/gl/stage.h"
#include "viewer/gl/tiles.h"

namespace splatbus::viewer::gl {
namespace {

Camera camera_of(std::uint32_t width, std::uint32_t height) {
  return look_at({0, 0, 3}, {0, 0, 0}, width, height, 0.9F);
}

/// Of sizes from a part of a pixel to the whole picture, thin and round, within the picture and beyond its sides.
SharedBatch any_sizes(std::size_t count, float least_m = 0.002F, float most_m = 1.5F, float opacity = 0.9F) {
  auto batch = std::make_shared<Batch>();
  batch->whole = true;
  batch->object_ids = {kWorldFrame};
  std::mt19937 random(7);
  std::uniform_real_distribution<float> part(0, 1);
  const auto log_scale = [&] {
    const float log_m = std::lerp(std::log(least_m), std::log(most_m), part(random));
    return static_cast<std::int16_t>(std::lround(log_m / stream::kLogScaleStep));
  };
  for (std::size_t k = 0; k < count; ++k) {
    stream::GpuRecord record;
    for (float& x : record.mean) x = 4 * part(random) - 2;
    for (std::int16_t& scale : record.log_scale) scale = log_scale();
    for (std::int16_t& turn : record.rotation) turn = static_cast<std::int16_t>(60'000 * part(random) - 30'000);
    record.opacity_object = static_cast<std::uint32_t>(255 * opacity * part(random));
    record.color = stream::shared_exponent_rgb({part(random), part(random), part(random)});
    batch->update.rows.push_back(static_cast<std::uint32_t>(k));
    batch->update.records.push_back(record);
    batch->update.fades.push_back(kNoFade);
  }
  return batch;
}

/// Root of the mean square and the most, in steps of 8 bits.
struct Difference {
  double root = 0;
  int most = 0;
};

Difference between(const Picture& a, const Picture& b) {
  EXPECT_EQ(a.rgba.size(), b.rgba.size());
  Difference out;
  for (std::size_t k = 0; k < a.rgba.size(); ++k) {
    const int apart = std::abs(int{a.rgba[k]} - int{b.rgba[k]});
    out.root += apart * apart;
    out.most = std::max(out.most, apart);
  }
  out.root = std::sqrt(out.root / static_cast<double>(a.rgba.size()));
  return out;
}

class GlTiles : public ::testing::Test {
 protected:
  GlTiles() { scene_.light.background = {0.2F, 0.1F, 0.4F}; }

  Picture capture(Stage& stage, const Camera& camera) { return stage.capture(camera, scene_, kSettled_s); }

  GlContext context_;
  SceneState scene_;
};

TEST_F(GlTiles, DrawAsQuadsAtAnySize) {
  Stage quads(Draw::Quads), tiles(Draw::Tiles);
  const SharedBatch rows = any_sizes(900);
  quads.add(*rows);
  tiles.add(*rows);
  static_cast<void>(capture(tiles, camera_of(640, 480)));  // makes room
  for (const auto& [width, height] : {std::pair{250U, 131U}, {640U, 480U}, {16U, 16U}, {17U, 15U}, {9U, 300U}}) {
    const Difference difference =
        between(capture(quads, camera_of(width, height)), capture(tiles, camera_of(width, height)));
    EXPECT_LT(difference.root, 0.5) << width << " x " << height;
    EXPECT_LE(difference.most, 3) << width << " x " << height;
  }
  EXPECT_EQ(tiles.drawn().by_tiles, 5U);
}

TEST_F(GlTiles, DrawTheBenchsFloorAsQuads) {
  Stage quads(Draw::Quads), tiles(Draw::Tiles);
  const SharedBatch floor = wavy_floor(30'000);
  quads.add(*floor);
  tiles.add(*floor);
  const Camera camera = look_at({5, 4, 6}, {0, 0, 0}, 320, 180, 1);
  const Difference difference = between(capture(quads, camera), capture(tiles, camera));
  EXPECT_LT(difference.root, 0.5);
  EXPECT_LE(difference.most, 4);
  EXPECT_EQ(tiles.drawn().by_tiles, 1U);
}

TEST_F(GlTiles, DrawTheBackgroundWhereNothingIs) {
  Stage quads(Draw::Quads), tiles(Draw::Tiles);
  const Camera camera = camera_of(100, 40);
  EXPECT_EQ(capture(tiles, camera).rgba, capture(quads, camera).rgba) << "no rows";
  tiles.add(*any_sizes(100));
  static_cast<void>(capture(tiles, camera));
  const Camera away = look_at({0, 0, 3}, {0, 0, 9}, 100, 40, 0.9F);
  EXPECT_EQ(capture(tiles, away).rgba, capture(quads, away).rgba) << "none in sight, in front of what was";
  EXPECT_EQ(tiles.drawn().by_quads, 0U);
  EXPECT_EQ(tiles.drawn().pairs, 0U);
}

TEST_F(GlTiles, WithoutRoomAreQuadsAndThenThereIsRoom) {
  Stage quads(Draw::Quads), tiles(Draw::Tiles);
  const SharedBatch rows = any_sizes(400, 0.5F, 1.5F, 0.3F);  // nearly all touch nearly all tiles
  quads.add(*rows);
  tiles.add(*rows);
  const Camera camera = camera_of(200, 200);
  const Picture expected = capture(quads, camera);
  EXPECT_EQ(capture(tiles, camera).rgba, expected.rgba);
  EXPECT_EQ(tiles.drawn().without_room, 1U);
  EXPECT_EQ(tiles.drawn().by_tiles, 0U);
  EXPECT_GT(tiles.drawn().pairs, 400U * 40);
  const Difference difference = between(capture(tiles, camera), expected);
  EXPECT_LT(difference.root, 1) << "hundreds of layers, each rounded to 16 bits by quads alone";
  EXPECT_EQ(tiles.drawn().without_room, 1U);
  EXPECT_EQ(tiles.drawn().by_tiles, 1U);
}

TEST_F(GlTiles, AutoSettlesOnOneWayAndDrawsTheSame) {
  Stage quads(Draw::Quads), any(Draw::Auto);
  const SharedBatch rows = any_sizes(300);
  quads.add(*rows);
  any.add(*rows);
  const Camera camera = camera_of(120, 80);
  const Picture expected = capture(quads, camera);
  int pictures = 0;
  do {
    EXPECT_LT(between(capture(any, camera), expected).root, 0.5);
    static_cast<void>(any.drawn());
  } while (any.choice().trial() != 0 && ++pictures < 60);
  EXPECT_EQ(any.choice().trial(), 0U);
  EXPECT_GT(any.choice().cost_ms(Way::Quads), 0);
  EXPECT_GT(any.choice().cost_ms(Way::Tiles), 0);
  EXPECT_GE(any.drawn().by_quads, 5U);
  EXPECT_GE(any.drawn().by_tiles, 5U);
}

TEST_F(GlTiles, WithoutRoomAreNotWhatATrialTakesForTiles) {
  Stage any(Draw::Auto);
  any.add(*any_sizes(400, 0.5F, 1.5F, 0.3F));
  for (int k = 0; k < 60 && any.choice().decided() == 0; ++k) {
    static_cast<void>(capture(any, camera_of(200, 200)));
    static_cast<void>(any.drawn());
  }
  EXPECT_EQ(any.drawn().without_room, 1U);
  EXPECT_EQ(any.choice().decided(), 2U) << "the first one begins anew";
}

TEST_F(GlTiles, AreTimedStepByStep) {
  for (const Draw draw : {Draw::Quads, Draw::Tiles}) {
    Stage stage(draw);
    stage.add(*any_sizes(300));
    stage.set_timed(true);
    static_cast<void>(capture(stage, camera_of(64, 64)));
    const std::vector<StepTimes> times = stage.take_times();
    ASSERT_EQ(times.size(), 1U);
    const StepTimes& t = times[0];
    EXPECT_NEAR(t.all_ms, t.project_ms + t.sort_ms + t.pairs_ms + t.tile_sort_ms + t.draw_ms + t.resolve_ms, 1e-6);
    EXPECT_EQ(t.way == Way::Tiles, draw == Draw::Tiles);
    EXPECT_EQ(t.pairs_ms > 0, draw == Draw::Tiles);
    EXPECT_EQ(t.tile_sort_ms > 0, draw == Draw::Tiles);
    EXPECT_GT(t.draw_ms, 0);
  }
}

TEST_F(GlTiles, FlyAsTheyAreAsked) {
  for (const Draw draw : {Draw::Quads, Draw::Tiles}) {
    Stage stage(draw);
    const SharedBatch floor = wavy_floor(500);
    stage.add(*floor);
    constexpr double kRowsPerS = 2'000;
    FlightFigures figures;
    double seconds = 0.125;
    // A picture by software may take a second where others compute, and the first one changes nothing.
    do {
      seconds *= 4;
      figures = fly(stage, scene_, *floor->bounds, 64, 36, seconds, {floor, kRowsPerS});
    } while (figures.frames < 3 && seconds < 30);
    EXPECT_GT(figures.rows_changed, 0U);
    EXPECT_LE(static_cast<double>(figures.rows_changed), kRowsPerS * seconds + 500) << "and a last picture's";
    const Drawn& drawn = figures.drawn;
    EXPECT_GT(draw == Draw::Tiles ? drawn.by_tiles : drawn.by_quads, 0U);
    EXPECT_EQ(draw == Draw::Tiles ? drawn.by_quads : drawn.by_tiles, 0U);
    EXPECT_EQ(drawn.pairs > 0, draw == Draw::Tiles);
    EXPECT_GT(figures.device.all_ms, 0);
  }
}

/// What is behind a Stage, to see the lists themselves.
class GlTileLists : public GlTiles {
 protected:
  GlTileLists() { rows_.apply(any_sizes(100, 0.5F, 1.5F)->update); }

  Tiles::Listed list(Tiles& tiles) {
    const Frame frame{.camera = camera_of(160, 160), .transforms = transforms_of(scene_, {kWorldFrame})};
    projection_.run(rows_, frame, timer_);
    tiles.list(projection_, rows_.capacity(), 160, 160, timer_);
    glFinish();
    const auto listed = tiles.take();
    EXPECT_TRUE(listed);
    return listed.value_or(Tiles::Listed{});
  }
  unsigned quads_to_draw() {
    Seen seen{};
    glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
    glGetNamedBufferSubData(projection_.seen(), 0, sizeof(seen), &seen);
    return seen.draw[1];
  }

  RowStore rows_;
  Projection projection_;
  FrameTimer timer_;
};

TEST_F(GlTileLists, StayWithinTheirBound) {
  Tiles tiles(17'000);
  rows_.apply(any_sizes(400, 0.5F, 1.5F)->update);
  for (int k = 0; k < 3; ++k) {
    const Tiles::Listed listed = list(tiles);
    EXPECT_GT(listed.pairs, 17'000U);
    EXPECT_FALSE(listed.fitted);
    EXPECT_FALSE(listed.grown);
    EXPECT_LE(tiles.capacity(), 17'000U);
    EXPECT_GT(quads_to_draw(), 0U);
  }
}

TEST_F(GlTileLists, ThatFitLeaveNoQuads) {
  Tiles tiles;
  const Tiles::Listed listed = list(tiles);
  EXPECT_TRUE(listed.fitted);
  EXPECT_GT(listed.pairs, 100U);
  EXPECT_LE(listed.pairs, 100U * 100);
  EXPECT_EQ(quads_to_draw(), 0U);
}

TEST_F(GlTileLists, ComeBackAfterTheirRoomWasGivenBack) {
  Tiles tiles;
  const std::size_t pairs = list(tiles).pairs;
  EXPECT_GE(tiles.capacity(), pairs);
  tiles.release();
  EXPECT_EQ(tiles.capacity(), 0U);
  const Tiles::Listed listed = list(tiles);
  EXPECT_TRUE(listed.fitted);
  EXPECT_EQ(listed.pairs, pairs);
}

}  // namespace
}  // namespace splatbus::viewer::gl
