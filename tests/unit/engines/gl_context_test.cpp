#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "gl/context.h"

namespace splatbus {
namespace {

TEST(GlContext, IsTheFirstThatSuits) {
  const std::string any = GlContext().description();
  std::vector<std::string> asked;
  const GlContext chosen([&](const GlContext& context) {
    EXPECT_NE(glGetString(GL_VERSION), nullptr) << "nothing is current while it is asked";
    asked.push_back(context.description());
    return true;
  });
  EXPECT_EQ(asked, std::vector<std::string>{any});
  EXPECT_EQ(chosen.description(), any);
}

TEST(GlContext, IsAnotherThanTheFirstWhereThatOneSuits) {
  std::vector<std::string> asked;
  const GlContext context([&](const GlContext& one) {
    asked.push_back(one.description());
    return asked.size() == 2;
  });
  if (asked.size() < 2) GTEST_SKIP() << "there is one: " << context.description();
  EXPECT_EQ(context.description(), asked[1]);
  EXPECT_NE(context.description(), asked[0]);
}

TEST(GlContext, IsTheFirstOfAllWhereNoneSuits) {
  const std::string any = GlContext().description();
  int asked = 0;
  const GlContext context([&](const GlContext&) { return ++asked, false; });
  EXPECT_GE(asked, 1);
  EXPECT_EQ(context.description(), any);
  EXPECT_NE(glGetString(GL_VERSION), nullptr) << "what was tried last is not what is current";
}

}  // namespace
}  // namespace splatbus
