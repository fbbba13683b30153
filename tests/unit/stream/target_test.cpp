// What viewers hold against the published model itself, in every attribute, by formulas of the test's own.
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>

#include "expectations.h"
#include "shown_replica.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::join;
using test::ToyServer;

struct Tolerance {
  float mean = 0, log_scale = 0, rotation = 0, opacity = 0, color = 0, coefficients = 0;  ///< steps
};

float sigmoid(float x) {
  return 1 / (1 + std::exp(-x));
}

float display(float linear) {
  return std::copysign(srgb_from_linear(std::abs(linear)), linear);
}

glm::quat rotation(const GaussiansView& g, std::size_t i) {
  return glm::normalize(glm::quat(*g.at(6, i), *g.at(7, i), *g.at(8, i), *g.at(9, i)));
}

/// Radians between two rotations of an ellipsoid, which looks the same after half a turn about an axis of its own.
float angle_between(const glm::quat& a, const glm::quat& b) {
  float cosine = 0;
  for (const glm::quat& turn :
       {glm::quat(1, 0, 0, 0), glm::quat(0, 1, 0, 0), glm::quat(0, 0, 1, 0), glm::quat(0, 0, 0, 1)}) {
    cosine = std::max(cosine, std::abs(glm::dot(a * turn, b)));
  }
  return 2 * std::acos(std::min(cosine, 1.0F));
}

/// The largest difference between what is shown and what was published, as a part of what is allowed.
class Differences {
 public:
  Differences(ToyServer& server, test::ShownReplica& replica, const Tolerance& allowed)
      : want_(server.model().view()), got_(replica.view()) {
    EXPECT_EQ(replica.count(), want_.count);
    std::map<std::uint64_t, std::size_t> column;
    for (std::size_t i = 0; i < want_.count; ++i) column[want_.gaussian_id[i]] = i;
    const float mean_step_m = replica.held().layout.at(Attribute::Mean).quantizer.step;
    test::for_each_held(server, replica, [&](std::uint64_t id, std::uint32_t row) {
      const auto found = column.find(id);
      if (found == column.end()) {
        ADD_FAILURE() << "row " << row << " holds an id that was not published";
        return;
      }
      slot_ = row;
      i_ = found->second;
      compare(allowed, mean_step_m);
    });
  }

  [[nodiscard]] const std::map<std::string, float>& largest() const { return largest_; }

 private:
  void compare(const Tolerance& t, float mean_step_m) {
    const auto channels = [&](const char* name, int first, int count, float allowed, auto map) {
      for (int c = first; c < first + count; ++c)
        note(name, map(*got_.at(c, slot_)) - map(want_.plane(c)[i_]), allowed);
    };
    const auto same = [](float x) { return x; };
    const int last = want_.layout.channels();
    channels("mean", 0, 3, (t.mean + 0.5F) * mean_step_m, same);
    channels("log-scale", 3, 3, (t.log_scale + 0.5F) / 64, same);
    // Each of the three coordinates of the rotation vector may be off by as much.
    note("rotation", angle_between(rotation(got_, slot_), rotation(want_, i_)),
         (t.rotation + 0.5F) / 128 * std::sqrt(3.0F) + 1e-3F);
    channels("opacity", 10, 1, (t.opacity + 0.5F) / 255 + 1e-3F, sigmoid);
    if (want_.layout.appearance == Appearance::Transfer) {
      channels("albedo", 11, 3, (t.color + 0.5F) / 255, display);
      channels("residual", 14, last - 14, (t.coefficients + 0.5F) / 128, same);
      note("visibility", got_.visibility[slot_] - want_.visibility[i_],
           (StreamModel::kMaxVisibilityError + 0.5F) / 255);
      for (std::size_t c = 0; c < 3; ++c) {
        note("normal", got_.normal[c * got_.stride + slot_] - want_.normal[c * want_.stride + i_], 0.004F);
      }
    } else {
      channels("SH, degree 0", 11, 3, (t.color + 0.5F) / 72, same);
      channels("SH, other degrees", 14, last - 14, (t.coefficients + 0.5F) / 64, same);
    }
    note("object", static_cast<float>(got_.object_id[slot_]) - static_cast<float>(want_.object_id[i_]), 0.5F);
  }

  void note(const char* name, float difference, float allowed) {
    largest_[name] = std::max(largest_[name], std::abs(difference) / (1.002F * allowed));
  }

  GaussiansView want_, got_;
  std::size_t i_ = 0, slot_ = 0;
  std::map<std::string, float> largest_;
};

void expect_near(ToyServer& server, test::ShownReplica& replica, const Tolerance& allowed, int tick) {
  const Differences differences(server, replica, allowed);
  for (const auto& [name, part] : differences.largest()) {
    EXPECT_LE(part, 1) << name << " after tick " << tick;
  }
}

class Target : public testing::TestWithParam<Appearance> {
 protected:
  /// An attribute is sent at every tick: what differs is within its dead zone at once.
  void send_all_at_every_tick() {
    Schedules schedules = default_schedules();
    for (AttributeSchedule& schedule : schedules) schedule.every = 1;
    server_.stream.set_schedules(schedules);
    join(server_.stream, replica_);
  }

  [[nodiscard]] static bool transfer() { return GetParam() == Appearance::Transfer; }

  ToyServer server_{41, 500, GetParam()};
  test::ShownReplica replica_;
};

TEST_P(Target, WhatMovesIsHeldToWithinTheDeadZones) {
  send_all_at_every_tick();
  const Tolerance zones{
      .mean = 2, .log_scale = 2, .rotation = 3, .opacity = 2, .color = 1, .coefficients = transfer() ? 0.0F : 1.0F};
  for (int tick = 0; tick < 25 && !HasFailure(); ++tick) {
    if (tick % 4 == 1) server_.insert(40);
    if (tick % 4 == 3) server_.remove(30);
    server_.train(tick % 2 == 0 ? 0.03F : 0.004F);
    server_.tick_for(replica_);
    expect_near(server_, replica_, zones, tick);
  }
}

TEST_P(Target, WhatRestsIsHeldToWithinAStep) {
  send_all_at_every_tick();
  for (int tick = 0; tick < 5; ++tick) {
    server_.train(0.01F);
    server_.tick_for(replica_);
  }
  for (int tick = 0; tick < 10; ++tick) server_.tick_for(replica_);
  expect_near(
      server_, replica_,
      {.mean = 1, .log_scale = 1, .rotation = 1, .opacity = 1, .color = 1, .coefficients = transfer() ? 0.0F : 1.0F},
      15);
  EXPECT_TRUE(server_.tick().empty());
}

INSTANTIATE_TEST_SUITE_P(Appearances, Target, testing::Values(Appearance::Transfer, Appearance::Radiance));

}  // namespace
}  // namespace splatbus::stream
