// The JSON schema of launch files, for editors.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>

#include "launch_file.h"

namespace splatbus::cli {
namespace {

TEST(LaunchSchema, IsTheOneThatIsPublished) {
  const auto folder = std::filesystem::path(SPLATBUS_SOURCE_DIR) / "launch";
  std::ifstream stream(folder / "launch.schema.json");
  const std::string published(std::istreambuf_iterator<char>(stream), {});
  EXPECT_EQ(published, launch_schema()) << "splatbus launch --schema > launch/launch.schema.json";
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".yaml") continue;
    std::ifstream file(entry.path());
    std::string line;
    std::getline(file, line);
    EXPECT_EQ(line, "# yaml-language-server: $schema=launch.schema.json") << entry.path();
  }
}

TEST(LaunchSchema, HasWhatTheReaderTakes) {
  const auto schema = nlohmann::json::parse(launch_schema());
  const auto& service = schema.at("properties").at("services").at("items");
  EXPECT_EQ(service.at("required"), nlohmann::json({"name"}));
  EXPECT_EQ(service.at("additionalProperties"), false);
  EXPECT_EQ(service.at("properties").at("replicas").at("anyOf").at(0),
            nlohmann::json({{"type", "integer"}, {"minimum", 1.0}, {"maximum", 64.0}}));
  EXPECT_EQ(schema.at("properties").at("backend").at("anyOf").at(0).at("enum"),
            nlohmann::json({"cpu", "cuda", "auto"}));
  EXPECT_TRUE(service.at("properties").at("restart").at("anyOf").at(0).contains("anyOf")) << "a word or a map";
  for (const auto& [name, property] : service.at("properties").items()) {
    EXPECT_FALSE(property.at("description").get<std::string>().empty()) << name;
  }
}

}  // namespace
}  // namespace splatbus::cli
