// What fades: Gaussians, by the ids that the server knows, and not rows.
#include "viewer/row_feed.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include "../../stream/toy_server.h"

namespace splatbus::viewer {
namespace {

using stream::test::ToyServer;

constexpr float kTick_s = 0.05F, kFade_s = 0.25F;
constexpr float kNear_m = 0.12F;  // a quarter of the largest

/// What a stage has in its memory.
struct Memory {
  struct Row {
    stream::GpuRecord record;
    float fade;
  };
  std::map<std::uint32_t, Row> rows;  ///< that are not free

  void take(const gl::SharedBatch& batch) {
    if (!batch) return;
    std::set<std::uint32_t> once;
    for (std::size_t k = 0; k < batch->update.rows.size(); ++k) {
      const std::uint32_t row = batch->update.rows[k];
      const stream::GpuRecord& record = batch->update.records[k];
      EXPECT_TRUE(once.insert(row).second || (record.opacity_object & 0xFFU) == 0) << "row " << row << " twice";
      rows.erase(row);
      if ((record.opacity_object & 0xFFU) > 0) rows[row] = {record, batch->update.fades[k]};
    }
  }
};

/// Where Gaussians are tells them apart, as none of them moves.
using Mean = std::array<float, 3>;

/// `Count`: of a page, or of several, between which Gaussians change over as if they left one and arrived in another.
class RowFeedTest : public ::testing::Test {
 protected:
  explicit RowFeedTest(std::size_t count = 700) : server_(31, count) { stream::test::join(server_.stream, replica_); }

  std::map<std::uint64_t, Mean> means_by_id() {
    std::map<std::uint64_t, Mean> out;
    const stream::ReplicatedState& held = replica_.held();
    const stream::RecordMaker maker(held.gaussians, held.layout);
    stream::test::for_each_held(server_, replica_, [&](std::uint64_t id, std::uint32_t row) {
      EXPECT_TRUE(out.emplace(id, maker.record(row, 0).mean).second) << "Gaussian " << id << " twice";
    });
    return out;
  }

  /// What the server has become; notes who has arrived and who has left.
  void tick() {
    const auto before = means_by_id();
    server_.tick_for(replica_);
    there_ = means_by_id();
    for (const auto& [id, mean] : before) {
      if (!there_.contains(id)) left_[mean] = now_s_;
    }
    for (const auto& [id, mean] : there_) {
      if (!before.contains(id)) arrived_[mean] = now_s_;
    }
  }

  /// `exact`: nothing vanishes but what has left.
  void expect_fades(bool exact) {
    memory_.take(feed_.take(now_s_));
    const auto is_over = [&](const auto& one) { return one.second + kFade_s <= now_s_ + 1e-3F; };
    std::erase_if(left_, is_over);
    std::erase_if(arrived_, is_over);
    std::map<Mean, std::vector<float>> solid, vanishing;
    for (const auto& [row, held] : memory_.rows) {
      if (held.fade < 0 && -held.fade + kFade_s <= now_s_ + 1e-3F) continue;  // nothing is seen of it any more
      (held.fade < 0 ? vanishing : solid)[held.record.mean].push_back(held.fade);
    }
    std::ptrdiff_t stand_ins = 0, replaced = 0;
    EXPECT_EQ(solid.size(), there_.size());
    for (const auto& [id, mean] : there_) {
      const std::vector<float>& drawn = solid[mean];
      ASSERT_EQ(drawn.size(), 1U) << "Gaussian " << id;
      const auto came = arrived_.find(mean);
      if (came != arrived_.end() &&
          !(drawn[0] == gl::kNoFade && has_near(left_, mean, [](const auto& one) { return one.first; }))) {
        EXPECT_EQ(drawn[0], came->second) << "Gaussian " << id << " arrives at once";
      } else if (came != arrived_.end()) {
        ++stand_ins;
      } else if (exact) {
        EXPECT_LE(drawn[0] + kFade_s, now_s_ + 1e-3F) << "Gaussian " << id << " fades in, and has been there";
      }
    }
    for (const auto& [mean, at_s] : left_) {
      const std::vector<float>& drawn = vanishing[mean];
      if (drawn.empty() && (has_near(there_, mean, [](const auto& one) { return one.second; }) ||
                            has_near(left_, mean, [](const auto& one) { return one.first; }))) {
        ++replaced;
        continue;
      }
      ASSERT_EQ(drawn.size(), 1U) << "it vanishes at once";
      EXPECT_EQ(drawn[0], -at_s);
    }
    EXPECT_LE(stand_ins, 2 + std::ssize(arrived_) / 20);
    EXPECT_LE(replaced, 2 + std::ssize(left_) / 20);
    const auto ghosts = std::ranges::count_if(vanishing, [](const auto& of) { return !of.second.empty(); });
    EXPECT_TRUE(!exact || ghosts + replaced == std::ssize(left_)) << ghosts << " of " << left_.size();
  }

  /// Whether there is one who may stand for it, which needs no fade.
  static bool has_near(const auto& all, const Mean& mean, const auto& mean_of) {
    return std::ranges::any_of(all, [&](const auto& one) {
      const Mean other = mean_of(one);
      return other != mean && std::hypot(other[0] - mean[0], other[1] - mean[1], other[2] - mean[2]) < kNear_m;
    });
  }

  void go_on() { now_s_ += kTick_s; }

  ToyServer server_;
  stream::Replica replica_;
  RowFeed feed_{replica_, true};
  Memory memory_;
  std::map<std::uint64_t, Mean> there_;
  std::map<Mean, float> left_, arrived_;
  float now_s_ = 10;
};

class RowFeedOfPages : public RowFeedTest {
 protected:
  RowFeedOfPages() : RowFeedTest(3000) {}
};

TEST_F(RowFeedTest, GaussiansFadeWhateverBecomesOfTheirRows) {
  tick();
  expect_fades(false);
  for (int turn = 0; turn < 80; ++turn) {
    go_on();
    for (int ticks = 0; ticks <= turn % 2; ++ticks) {  // taken together
      if ((turn + ticks) % 3 == 0) server_.remove(60);
      if ((turn + ticks) % 3 == 1) server_.insert(60);
      tick();
    }
    expect_fades(turn > 5);
    if (HasFailure()) FAIL() << "turn " << turn;
  }
}

TEST_F(RowFeedOfPages, APageThatTakesTheRowsOfAnotherLetsItFade) {
  tick();
  expect_fades(false);
  const std::size_t rows = feed_.capacity();
  for (int turn = 0; turn < 60; ++turn) {
    go_on();
    if (turn % 8 == 0) server_.remove(300);
    if (turn % 8 == 1) server_.insert(300);
    tick();
    expect_fades(false);
    if (HasFailure()) FAIL() << "turn " << turn;
  }
  EXPECT_LE(feed_.capacity(), rows + stream::kChunkRows);
}

}  // namespace
}  // namespace splatbus::viewer
