#include "json_text.h"

#include <gtest/gtest.h>

namespace splatbus::cli {
namespace {

TEST(JsonText, BytesThatAreNotUtf8AreReplaced) {
  const nlohmann::json json{{"topic\xff", {"sour\xc3", "d\xc3\xa9j\xc3\xa0"}}};
  EXPECT_EQ(json_text(json), "{\"topic\xef\xbf\xbd\":[\"sour\xef\xbf\xbd\",\"d\xc3\xa9j\xc3\xa0\"]}");
  EXPECT_FALSE(nlohmann::json::parse(json_text(json, 2), nullptr, false).is_discarded());
}

TEST(JsonText, OneLineUnlessIndented) {
  const nlohmann::json json{{"a", 1}, {"b", nullptr}};
  EXPECT_EQ(json_text(json), R"({"a":1,"b":null})");
  EXPECT_EQ(json_text(json, 2), "{\n  \"a\": 1,\n  \"b\": null\n}");
}

}  // namespace
}  // namespace splatbus::cli
