#include "wire/schemas.h"

#include <flatbuffers/reflection_generated.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <regex>
#include <set>
#include <string>

namespace splatbus::wire {
namespace {

std::string read_text(const std::filesystem::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST(WireSchemas, EveryTableThatTheBusCarriesIsFound) {
  const std::string text = read_text(SPLATBUS_SOURCE_DIR "/libs/wire/topics.h");
  const std::regex name(R"re(kSchema<wire::(\w+)> = "(\w+/\d+)")re");
  std::set<std::string> seen;
  for (std::sregex_iterator it(text.begin(), text.end(), name), end; it != end; ++it) {
    const std::string table = (*it)[1], schema = (*it)[2];
    seen.insert(table);
    const auto found = find_schema(schema);
    ASSERT_TRUE(found.has_value()) << schema;
    EXPECT_EQ(found->table, "splatbus.wire." + table);
    flatbuffers::Verifier verifier(found->binary.data(), found->binary.size());
    ASSERT_TRUE(reflection::VerifySchemaBuffer(verifier)) << schema;
    const auto* object = reflection::GetSchema(found->binary.data())->objects()->LookupByKey(found->table.data());
    ASSERT_NE(object, nullptr) << schema;
    EXPECT_NE(object->fields()->LookupByKey("header"), nullptr) << schema;
  }
  EXPECT_GE(seen.size(), 22U) << "the expression has stopped to match";
}

TEST(WireSchemas, OtherVersionsAndStructsAreNot) {
  for (const char* schema : {"EngineFrame/1", "EngineFrame", "EngineFrame/30", "Vec3/1", "Nonsense/1", ""}) {
    EXPECT_FALSE(find_schema(schema).has_value()) << schema;
  }
}

}  // namespace
}  // namespace splatbus::wire
