// Pins the wire format: for every message of every schema, its bytes and their JSON. A change that is meant is written
// down with
//   SPLATBUS_UPDATE_GOLDEN=1 build/release/bin/test_golden
// and shows in review as a change of tests/golden/messages.
#include <flatbuffers/idl.h>
#include <flatbuffers/reflection.h>
#include <flatbuffers/util.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <set>
#include <string>

#include "example.h"
#include "wire/capture_generated.h"
#include "wire/engine_generated.h"
#include "wire/model_generated.h"
#include "wire/sampling_generated.h"
#include "wire/scene_generated.h"
#include "wire/share_generated.h"
#include "wire/stream_generated.h"
#include "wire/system_generated.h"
#include "wire/trace_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::golden {
namespace {

const std::filesystem::path source_dir = SPLATBUS_SOURCE_DIR;
const auto golden_dir = source_dir / "tests" / "golden" / "messages";
const char* const families[] = {"common", "engine", "scene", "capture", "model",   "viewer",
                                "system", "stream", "trace", "share",   "sampling"};

std::string load(const std::filesystem::path& path, bool binary) {
  std::string text;
  EXPECT_TRUE(flatbuffers::LoadFile(path.c_str(), binary, &text))
      << path << " is missing; is a message new? See the top of golden_test.cpp";
  return text;
}

bool updating() {
  return std::getenv("SPLATBUS_UPDATE_GOLDEN") != nullptr;
}

std::unique_ptr<flatbuffers::Parser> load_schema(const std::string& family) {
  flatbuffers::IDLOptions options;
  options.strict_json = true;
  options.indent_step = 2;
  options.output_default_scalars_in_json = true;
  auto parser = std::make_unique<flatbuffers::Parser>(options);
  const auto path = (source_dir / "schemas" / (family + ".fbs")).string();
  const auto directory = (source_dir / "schemas").string();
  const char* includes[] = {directory.c_str(), nullptr};
  EXPECT_TRUE(parser->Parse(load(path, false).c_str(), includes, path.c_str())) << parser->error_;
  return parser;
}

std::string build(flatbuffers::Parser& schema, const Example& example) {
  EXPECT_TRUE(schema.SetRootType(("splatbus.wire." + example.root).c_str()));
  EXPECT_TRUE(schema.Parse(example.json.c_str())) << example.name << ": " << schema.error_;
  return {reinterpret_cast<const char*>(schema.builder_.GetBufferPointer()), schema.builder_.GetSize()};
}

std::string to_json(flatbuffers::Parser& schema, const Example& example, const std::string& bytes) {
  EXPECT_TRUE(schema.SetRootType(("splatbus.wire." + example.root).c_str()));
  std::string json;
  EXPECT_TRUE(flatbuffers::GenerateText(schema, bytes.data(), &json)) << example.name;
  return json;
}

bool verifies(flatbuffers::Parser& schema, const Example& example, const std::string& bytes) {
  schema.SetRootType(("splatbus.wire." + example.root).c_str());
  schema.Serialize();
  const std::string binary_schema(reinterpret_cast<const char*>(schema.builder_.GetBufferPointer()),
                                  schema.builder_.GetSize());
  const auto& reflection = *reflection::GetSchema(binary_schema.data());
  return flatbuffers::Verify(reflection, *reflection.root_table(), reinterpret_cast<const std::uint8_t*>(bytes.data()),
                             bytes.size());
}

class Golden : public testing::TestWithParam<const char*> {};

TEST_P(Golden, BytesAndJsonAreAsWrittenDown) {
  const auto schema = load_schema(GetParam());
  const auto decoder = load_schema(GetParam());
  const auto examples = make_examples(*schema);
  EXPECT_FALSE(examples.empty());
  for (const auto& example : examples) {
    const auto binary_path = golden_dir / (example.name + ".bin");
    const auto json_path = golden_dir / (example.name + ".json");
    const auto bytes = build(*schema, example);
    if (updating()) {
      std::filesystem::create_directories(golden_dir);
      const auto json = to_json(*decoder, example, bytes);
      ASSERT_TRUE(flatbuffers::SaveFile(binary_path.c_str(), bytes, true));
      ASSERT_TRUE(flatbuffers::SaveFile(json_path.c_str(), json, false));
      continue;
    }
    const auto golden = load(binary_path, true);
    EXPECT_TRUE(bytes == golden) << example.name << ": the bytes of this message have changed";
    if (golden.empty()) continue;
    EXPECT_TRUE(verifies(*decoder, example, golden)) << example.name;
    EXPECT_EQ(to_json(*decoder, example, golden), load(json_path, false)) << example.name;
  }
}

INSTANTIATE_TEST_SUITE_P(Families, Golden, testing::ValuesIn(families),
                         [](const auto& family) { return std::string(family.param); });

TEST(GoldenFiles, NoneIsLeftOver) {
  std::set<std::string> expected;
  for (const auto* family : families) {
    for (const auto& example : make_examples(*load_schema(family))) {
      expected.insert(example.name + ".bin");
      expected.insert(example.name + ".json");
    }
  }
  std::filesystem::create_directories(golden_dir);
  for (const auto& entry : std::filesystem::directory_iterator(golden_dir)) {
    const auto name = entry.path().filename().string();
    if (updating() && !expected.contains(name)) std::filesystem::remove(entry.path());
    EXPECT_TRUE(updating() || expected.contains(name)) << name << " belongs to no message";
  }
}

template <class T>
bool verify(const std::string& bytes) {
  flatbuffers::Verifier verifier(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
  return verifier.VerifyBuffer<T>(nullptr);
}

// What the generated C++ makes of the golden files, rather than the schema's parser.
TEST(GoldenFiles, GeneratedCodeReadsThem) {
  if (updating()) GTEST_SKIP() << "the files are being written";
  const std::map<std::string, std::function<bool(const std::string&)>> readers = {
      {"EngineCameras", verify<wire::EngineCameras>},
      {"EngineFrame", verify<wire::EngineFrame>},
      {"SceneUpdate", verify<wire::SceneUpdate>},
      {"SceneLightDepth", verify<wire::SceneLightDepth>},
      {"CaptureInput", verify<wire::CaptureInput>},
      {"CaptureReference", verify<wire::CaptureReference>},
      {"CaptureProbe", verify<wire::CaptureProbe>},
      {"ModelInsert", verify<wire::ModelInsert>},
      {"ModelPublished", verify<wire::ModelPublished>},
      {"TrainerStats", verify<wire::TrainerStats>},
      {"GridState", verify<wire::GridState>},
      {"RelightVisibility", verify<wire::RelightVisibility>},
      {"ViewerPose", verify<wire::ViewerPose>},
      {"ViewerProbe", verify<wire::ViewerProbe>},
      {"ViewerQuality", verify<wire::ViewerQuality>},
      {"Heartbeat", verify<wire::Heartbeat>},
      {"Liveness", verify<wire::Liveness>},
      {"Log", verify<wire::Log>},
      {"Control", verify<wire::Control>},
      {"Spans", verify<wire::Spans>},
      {"TraceRequest", verify<wire::TraceRequest>},
      {"StreamShare", verify<wire::StreamShare>},
      {"SamplingOffer", verify<wire::SamplingOffer>},
      {"SamplingRound", verify<wire::SamplingRound>},
      {"SamplingResult", verify<wire::SamplingResult>},
      {"Packet.Hello", verify<wire::Packet>}};
  for (const auto& [name, reads] : readers) {
    const auto bytes = load(golden_dir / (name + ".bin"), true);
    EXPECT_TRUE(reads(bytes)) << name;
    ASSERT_TRUE(verify<wire::Envelope>(bytes)) << name;
    const auto* header = flatbuffers::GetRoot<wire::Envelope>(bytes.data())->header();
    EXPECT_TRUE(header->schema()->str().starts_with(name.substr(0, name.find('.')) + "/")) << name;
    EXPECT_EQ(header->source()->str(), "source 1");
    ASSERT_EQ(header->tensors()->size(), 2u) << name;
    EXPECT_EQ(header->tensors()->Get(0)->span()->storage(), wire::Storage::Inline);
    EXPECT_EQ(header->tensors()->Get(0)->type(), wire::ElementType::F32);
  }
  const auto bytes = load(golden_dir / "EngineFrame.bin", true);
  const auto* frame = flatbuffers::GetRoot<wire::EngineFrame>(bytes.data());
  EXPECT_GT(frame->scene()->frame(), 1'000'000'000'000u);
  EXPECT_EQ(frame->camera()->role(), wire::CameraRole::Light);
  EXPECT_EQ(frame->camera()->cx(), frame->camera()->fy() + 1);
  EXPECT_EQ(frame->camera()->world_from_camera().rotation().x(),
            frame->camera()->world_from_camera().rotation().w() + 1);
  EXPECT_EQ(frame->scene()->objects()->size(), 2u);
}

}  // namespace
}  // namespace splatbus::golden
