// A display shows what was seen of the lights under an earlier version of the scene, and then what is seen now. Truth
// is what the display itself held when that version was the newest.
#include "stream/visibility_history.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "stream/display_gaussians.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {
namespace {

const StreamLayout kLayout(ParameterLayout{}, 1.0F / 1024);
constexpr std::uint32_t kRows = 4 * kBlockRows;
constexpr std::uint32_t kLamp = 9;

class VisibilityHistoryTest : public testing::Test {
 protected:
  VisibilityHistoryTest() {
    changes_.add(DisplayReset{kLayout});
    changes_.add(DisplayVisibility{90});
    std::vector<std::uint32_t> rows(kRows);
    for (std::uint32_t row = 0; row < kRows; ++row) rows[row] = row;
    replace(rows, 255);
    for (std::uint64_t v = 91; v < 96; ++v) changes_.add(DisplayVisibility{v});  // it is long there
    changes_.add(DisplayBlocks{{{0, kBlockRows}, {1, kBlockRows}, {2, kBlockRows}, {3, kBlockRows}}});
  }

  void replace(const std::vector<std::uint32_t>& rows, std::int32_t seen) {
    QuantizedGaussians gaussians;
    gaussians.object_id.assign(rows.size(), 0);
    gaussians.channels.assign(static_cast<std::size_t>(kLayout.channels()), std::vector<std::int32_t>(rows.size(), 0));
    gaussians.channels[static_cast<std::size_t>(kLayout.at(Attribute::Visibility).first)].assign(rows.size(), seen);
    changes_.add(DisplayRows{rows, gaussians});
  }
  void version(std::uint64_t scene_version) { changes_.add(DisplayVisibility{scene_version}); }
  void sun(std::vector<std::uint32_t> rows, std::vector<std::int32_t> seen) {
    if (lamp_) changes_.add(DisplaySeen{0, rows, Bytes(seen.begin(), seen.end())});
    changes_.add(DisplayValues{.attribute = Attribute::Visibility, .rows = std::move(rows), .values = std::move(seen)});
  }
  void lamp(std::vector<std::uint32_t> rows, Bytes seen) {
    changes_.add(DisplaySeen{kLamp, std::move(rows), std::move(seen)});
  }
  void add_lamp() {
    lamp_ = true;
    changes_.add(DisplayLights{{kLamp}});
    std::vector<std::uint32_t> rows(kRows);
    Bytes seen;
    const std::vector<float> now = take();
    for (std::uint32_t row = 0; row < kRows; ++row) {
      rows[row] = row;
      seen.push_back(static_cast<std::uint8_t>(std::lround(now[row] * 255)));
    }
    changes_.add(DisplaySeen{0, rows, seen});
  }

  /// Gives what has come to the display and the history; what the display has of the sun, and of the lamp.
  std::vector<float> take() {
    display_.apply(changes_);
    history_.add(changes_);
    changes_.clear();
    return held();
  }
  [[nodiscard]] std::vector<float> held() const {
    const GaussiansView view = display_.view();
    std::vector<float> held(view.visibility, view.visibility + kRows);
    for (std::uint32_t light = 0; lamp_ && light < 2; ++light) {
      const std::uint8_t* const seen = view.visibility_u8 + light * view.visibility_stride;
      held.insert(held.end(), seen, seen + kRows);
    }
    return held;
  }
  [[nodiscard]] std::vector<float> at(std::uint64_t scene_version) {
    const VisibilityHistory::Turn turn = history_.turn_to(scene_version);
    const std::vector<float> before = held();
    display_.apply(turn.there);
    std::vector<float> there = held();
    display_.apply(turn.back);
    EXPECT_EQ(held(), before) << "after a turn to " << scene_version;
    return there;
  }

  DisplayGaussians display_;
  VisibilityHistory history_;
  DisplayChanges changes_;
  bool lamp_ = false;
};

TEST_F(VisibilityHistoryTest, TurnsToTheNearestVersionWhicheverRowsHaveChangedSince) {
  add_lamp();
  const std::vector<float> first = take();
  std::mt19937 random(7);
  std::map<std::uint64_t, std::vector<float>> held_at;
  for (std::uint64_t v = 100; v < 140; v += 4) {
    version(v);
    for (int packet = 0; packet < 3; ++packet) {
      std::set<std::uint32_t> rows;
      for (int i = 0; i < 100; ++i) rows.insert(static_cast<std::uint32_t>(random() % kRows));
      std::vector<std::int32_t> seen;
      for (std::size_t i = 0; i < rows.size(); ++i) seen.push_back(static_cast<std::int32_t>(random() % 256));
      if (packet == 1) {
        lamp({rows.begin(), rows.end()}, Bytes(seen.begin(), seen.end()));
      } else {
        sun({rows.begin(), rows.end()}, seen);
      }
      held_at[v] = take();  // of the last packet in the end
    }
  }
  for (const auto& [v, held] : held_at) {
    EXPECT_EQ(at(v), held) << v;
    EXPECT_EQ(at(v + 1), held) << v;
    EXPECT_EQ(at(v - 1), held) << v;
  }
  EXPECT_EQ(at(1), first) << "the oldest";
  EXPECT_EQ(at(1000), held_at.at(136));
}

TEST_F(VisibilityHistoryTest, WhoCameSinceStaysAsHeIs) {
  version(5);
  sun({0, 1, 2}, {50, 51, 52});
  const std::vector<float> then = take();
  version(6);
  sun({0, 1, 2}, {60, 61, 62});
  replace({1}, 200);
  sun({1}, {201});
  take();
  version(7);
  sun({0, 1}, {70, 71});
  take();
  constexpr float kWhenHeCame = 201.0F / 255;
  EXPECT_NEAR(at(6)[1], kWhenHeCame, 1e-6);
  EXPECT_NEAR(at(5)[1], kWhenHeCame, 1e-6) << "not what another Gaussian saw in that row";
  EXPECT_EQ(at(5)[0], then[0]);
  EXPECT_EQ(at(5)[2], then[2]);
}

TEST_F(VisibilityHistoryTest, WhoCameInShadowIsNeverShownLit) {
  version(5);
  take();
  version(6);
  replace({2}, 255);  // nobody has looked yet
  take();
  version(7);
  sun({2}, {30});
  take();
  version(8);
  sun({2}, {40});
  take();
  for (const std::uint64_t v : {5U, 6U, 7U}) EXPECT_NEAR(at(v)[2] * 255, 30, 1e-3) << v;
  EXPECT_NEAR(at(8)[2] * 255, 40, 1e-3);
}

TEST_F(VisibilityHistoryTest, KeepsABoundedNumberOfValues) {
  version(5);
  take();
  version(6);
  const std::vector<std::uint32_t> rows = {4, 5, 6, 7};
  const auto many = [&] {
    for (std::size_t k = 0; k < VisibilityHistory::kMaxValues / rows.size() + 1; ++k) {
      const auto seen = static_cast<std::int32_t>(k % 200);
      sun(rows, {seen, seen, seen, seen});
    }
    take();
  };
  many();
  EXPECT_EQ(history_.turn_to(5).version, 6U) << "all of it is of one version, and still kept";
  version(7);
  sun({4}, {250});
  take();
  EXPECT_EQ(history_.turn_to(6).version, 6U) << "it went on no more";
}

TEST_F(VisibilityHistoryTest, ForgetsWhatWasBeforeOtherLights) {
  version(5);
  sun({0}, {10});
  take();
  version(6);
  sun({0}, {20});
  take();
  add_lamp();
  lamp({0}, {77});
  take();
  const std::vector<float> now = held();
  EXPECT_EQ(at(5), now);
  version(7);
  lamp({0}, {78});
  take();
  EXPECT_EQ(at(6), now);
  changes_.add(DisplayLights{{}});
  lamp_ = false;
  take();
  EXPECT_EQ(at(6), held());
}

TEST_F(VisibilityHistoryTest, KeepsABoundedNumberOfVersions) {
  take();
  constexpr std::uint64_t kVersions = 3 * VisibilityHistory::kMaxEntries;
  for (std::uint64_t v = 1; v <= kVersions; ++v) {
    version(v);
    sun({3}, {static_cast<std::int32_t>(v)});
    take();
  }
  const auto oldest = static_cast<float>(kVersions - VisibilityHistory::kMaxEntries);
  EXPECT_NEAR(at(1)[3] * 255, oldest, 1e-3);
  EXPECT_NEAR(at(kVersions - 3)[3] * 255, static_cast<float>(kVersions - 3), 1e-3);
}

TEST_F(VisibilityHistoryTest, ForgetsWhatWasBeforeAnotherModel) {
  version(1);
  sun({0}, {10});
  take();
  changes_.add(DisplayReset{kLayout});
  version(2);
  replace({0}, 90);
  take();
  EXPECT_EQ(history_.turn_to(1).version, 2U);
  EXPECT_EQ(history_.turn_to(1).there.list().size(), 0U);
}

}  // namespace
}  // namespace splatbus::stream
