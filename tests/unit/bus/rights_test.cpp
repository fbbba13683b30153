#include "bus/rights.h"

#include <gtest/gtest.h>

namespace splatbus::bus {
namespace {

TEST(Rights, NamesAndBack) {
  EXPECT_EQ(parse_rights(""), Rights());
  EXPECT_EQ(parse_rights("probe"), (Rights{.probe = true}));
  EXPECT_EQ(parse_rights("steer,view"), (Rights{.view = true, .steer = true}));
  EXPECT_EQ(parse_rights("view,steer,probe,control"), Rights::all());
  EXPECT_EQ(to_text(Rights::all()), "view,steer,probe,control");
  EXPECT_EQ(to_text({.view = true, .control = true}), "view,control");
  EXPECT_EQ(to_text(Rights{}), "");
}

TEST(Rights, AnUnknownNameIsNoRight) {
  for (const char* text : {"admin", "view,admin", "View", "view, steer", ",", "view,,steer"}) {
    EXPECT_FALSE(parse_rights(text).has_value()) << text;
  }
}

TEST(Rights, IncludeWhatIsNeeded) {
  EXPECT_TRUE(Rights::all().include({.steer = true, .control = true}));
  EXPECT_TRUE((Rights{.view = true}).include({}));
  EXPECT_FALSE((Rights{.view = true}).include({.view = true, .probe = true}));
  EXPECT_FALSE((Rights{.steer = true}).include({.control = true}));
}

}  // namespace
}  // namespace splatbus::bus
