#include "relight/relight.h"

#include <gtest/gtest.h>

#include <map>

#include "relight_fixture.h"

namespace splatbus::relight {
namespace {

using test::RelightTest;

TEST_F(RelightTest, FollowsModelLightAndObjects) {
  publish_model(1);
  publish_depth(1, -2.0F);
  EXPECT_EQ(visibility(1, 1), (std::vector<float>{1, 0, 1}));
  publish_depth(2, 2.0F);
  EXPECT_EQ(visibility(1, 2), (std::vector<float>{1, 0, 0})) << "the object has moved under the roof";
  publish_model(2, 2);
  EXPECT_EQ(visibility(2, 2), (std::vector<float>{1, 0}));
}

/// A picture's version is answered with its own map and transforms, though a newer one has come meanwhile.
TEST_F(RelightTest, EveryPicturedVersionIsComputed) {
  publish_model(1);
  publish_depth(9, -2.0F);
  ASSERT_EQ(visibility(1, 9), (std::vector<float>{1, 0, 1}));
  publish_depth(10, -2.0F);
  publish_depth(11, 2.0F);
  publish_depth(12, -2.0F);
  publish_picture(11);
  publish_picture(10);
  std::map<std::uint64_t, std::vector<float>> found;
  while (found.size() < 3 && !HasFailure()) {
    const auto [version, values] = next_visibility();
    found[version] = values;
  }
  EXPECT_EQ(found[10], (std::vector<float>{1, 0, 1}));
  EXPECT_EQ(found[11], (std::vector<float>{1, 0, 0}));
  EXPECT_EQ(found[12], (std::vector<float>{1, 0, 1}));
}

TEST_F(RelightTest, AnotherMapOfTheSameSceneAndAModelThatBeginsAnewAreFollowed) {
  publish_model(5);
  publish_depth(1, -2.0F);
  ASSERT_EQ(visibility(5, 1), (std::vector<float>{1, 0, 1}));
  publish_depth(1, -2.0F, true, 2.0F);  // the roof is beyond x = 2 in it
  EXPECT_EQ(visibility(5, 1), (std::vector<float>{1, 1, 1}));
  publish_model(2);
  EXPECT_EQ(visibility(2, 1), (std::vector<float>{1, 1, 1})) << "a trainer without the model before it";
}

TEST_F(RelightTest, BadMessagesHarmNobody) {
  publish_depth(1, 0, false);  // not the sun's camera
  publish_lie(1, 7);
  publish_lie(2);
  publisher_.publish(Topic<wire::RelightVisibility>{"scene/light_depth", false, kSchema<wire::SceneUpdate>},
                     [&](auto& builder, auto header) {
                       const std::uint32_t sun = 0;
                       return wire::CreateRelightVisibility(builder, header, 1, 1, 1, builder.CreateVector(&sun, 1));
                     });
  publish_model(3);
  publish_depth(4, -2.0F);
  EXPECT_EQ(visibility(3, 4), (std::vector<float>{1, 0, 1}));
}

}  // namespace
}  // namespace splatbus::relight
