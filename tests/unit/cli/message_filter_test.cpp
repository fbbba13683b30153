#include "message_filter.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

namespace splatbus::cli {
namespace {

using Json = nlohmann::json;
using testing::ElementsAre;

const Json kMessage = Json::parse(R"({
  "service": "trainer", "state": "Running", "pid": 42, "loss": 0.25, "ready": true, "detail": null, "version": "12",
  "cameras": [{"camera": {"id": 7}}, {"camera": {"id": 9}}],
  "words": "a, \"b\"\nc", "empty": ""
})");

TEST(FieldOf, FollowsNamesAndIndices) {
  EXPECT_EQ(field_of(kMessage, "pid"), 42);
  EXPECT_EQ(field_of(kMessage, "cameras.1.camera.id"), 9);
  EXPECT_EQ(field_of(kMessage, "cameras.0.camera"), Json({{"id", 7}}));
  for (const char* path : {"cameras.2", "cameras.-1", "cameras.1x", "cameras..0", "cameras.99999999999", "pid.0",
                           "none", "service.state"}) {
    EXPECT_TRUE(field_of(kMessage, path).is_null()) << path;
  }
}

TEST(CsvLine, IsQuotedByRfc4180) {
  EXPECT_EQ(csv_line({"a", "", "1.5"}), "a,,1.5");
  EXPECT_EQ(csv_line({"a,b", "say \"x\"", "two\nlines", "\r"}), "\"a,b\",\"say \"\"x\"\"\",\"two\nlines\",\"\r\"");
  EXPECT_EQ(csv_line({}), "");
  EXPECT_THAT(values_of(kMessage, {"service", "pid", "loss", "detail", "none", "cameras.0.camera"}),
              ElementsAre("trainer", "42", "0.25", "", "", "{\"id\":7}"));
}

bool holds(const std::string& expression) {
  return MessageFilter(expression).holds(kMessage);
}

TEST(MessageFilter, ComparesNumbersAndTexts) {
  for (const char* is : {"pid == 42", "pid==42", "pid >= 42", "pid <= 42", "pid < 42.5", "pid > -1", "pid != 41",
                         "loss < 1", "loss == 0.25", "service == trainer", "service == \"trainer\"",
                         "service > relight", "ready == true", "cameras.1.camera.id == 9"}) {
    EXPECT_TRUE(holds(is)) << is;
  }
  for (const char* is_not : {"pid == 41", "pid < 42", "pid > 42", "pid != 42", "loss >= 0.5", "service == relight",
                             "service != trainer", "service < relight", "ready == false", "cameras.1.camera.id == 7"}) {
    EXPECT_FALSE(holds(is_not)) << is_not;
  }
}

TEST(MessageFilter, OfOtherTypesOnlyUnequalHolds) {
  for (const char* left : {"service", "none", "detail", "version", "cameras"}) {
    for (const char* op : {"==", "<", "<=", ">", ">="})
      EXPECT_FALSE(holds(std::string(left) + op + "12")) << left << op;
    EXPECT_TRUE(holds(std::string(left) + " != 12")) << left;
  }
  EXPECT_TRUE(holds("version == \"12\"")) << "quotes make a text of a number";
}

TEST(MessageFilter, EveryTermHasToHold) {
  EXPECT_TRUE(holds("service == trainer && state == Running&&pid > 1"));
  EXPECT_FALSE(holds("service == trainer && state == Failed"));
  EXPECT_FALSE(holds("service == relight && state == Running"));
}

TEST(MessageFilter, SaysWhatMakesNoSense) {
  const auto error_of = [](const std::string& expression) -> std::string {
    try {
      const MessageFilter filter(expression);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "none";
  };
  EXPECT_EQ(error_of("pid"), "filter 'pid': 'pid' is not FIELD OP VALUE");
  for (const char* wrong : {"", "pid ==", "== 3", "pid = 3", "pid == 3 &&", "pid == 3 && && pid == 3", "a b == 3"}) {
    EXPECT_THAT(error_of(wrong), testing::HasSubstr("is not FIELD OP VALUE")) << wrong;
  }
}

}  // namespace
}  // namespace splatbus::cli
