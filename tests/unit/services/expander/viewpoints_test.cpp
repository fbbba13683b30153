// Where viewers will be, by the poses that they tell.
#include "expander/viewpoints.h"

#include <gtest/gtest.h>

#include "../../nanoseconds.h"

namespace splatbus::expander {
namespace {

/// A viewer that tells ten poses a second.
class ViewpointsTest : public testing::Test {
 protected:
  void look_from(float x) {
    now_ns_ += kSecond / 10;
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "ViewerPose/1", "viewer", 1, 1);
    const wire::Camera camera = to_wire(look_at({x, 1, 5}, {x, 1, 0}, 64, 48, 1.0F));
    builder.Finish(wire::CreateViewerPoseDirect(builder, header, "viewer", &camera));
    viewpoints_.take(*flatbuffers::GetRoot<wire::ViewerPose>(builder.GetBufferPointer()), now_ns_, now_ns_);
  }
  /// Along x, from where it is.
  [[nodiscard]] float way_in_2_s() {
    const auto all = viewpoints_.at(now_ns_, 2, {});
    if (all.size() != 1) return -1000;
    EXPECT_EQ(all[0].position.y, all[0].ahead.y);
    EXPECT_EQ(all[0].position.z, all[0].ahead.z);
    return all[0].ahead.x - all[0].position.x;
  }

  Viewpoints viewpoints_;
  std::int64_t now_ns_ = kSecond;
};

TEST_F(ViewpointsTest, WhoWalksIsExpectedWhereHisWayLeads) {
  for (int k = 0; k < 30; ++k) look_from(0.15F * static_cast<float>(k));
  EXPECT_NEAR(way_in_2_s(), 3, 0.01);
}

TEST_F(ViewpointsTest, WhoJumpsIsExpectedWhereHeIs) {
  float x = 0;
  for (int k = 0; k < 30; ++k) look_from(x += 0.15F);
  look_from(x += 50);
  EXPECT_EQ(way_in_2_s(), 0);
  for (int k = 0; k < 30; ++k) look_from(x += 0.15F);
  EXPECT_NEAR(way_in_2_s(), 3, 0.01);
}

TEST_F(ViewpointsTest, WhoWasSilentForLongIsExpectedWhereHeIs) {
  for (int k = 0; k < 30; ++k) look_from(0.15F * static_cast<float>(k));
  now_ns_ += kSecond;
  look_from(6);
  EXPECT_EQ(way_in_2_s(), 0);
}

}  // namespace
}  // namespace splatbus::expander
