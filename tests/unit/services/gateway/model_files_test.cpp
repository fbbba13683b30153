// The live model as files.
#include "gateway/model_files.h"

#include <algorithm>

#include "gateway_fixture.h"
#include "splats/file.h"

namespace splatbus::gateway_test {
namespace {

using gateway::ModelFiles;
using testing::HasSubstr;
using testing::StartsWith;

constexpr std::int64_t kSecondNs = 1'000'000'000;

class Models : public GatewayTest {
 protected:
  Models() : model_(stream::test::toy_model(1500, 1)) {
    for (std::uint32_t& object : model_.object_id) object = kWorldFrame;
  }
  void publish() {
    trainer_.publish(model_);
    trainer_.publish_light(Light{});
  }
  /// Asks at one and the same moment until it is decided.
  static ModelFiles::Found wait_for(ModelFiles& files, splats::Format format, std::int64_t now_ns) {
    ModelFiles::Found found;
    EXPECT_TRUE(bus_test::eventually([&] {
      found = files.find(format, now_ns);
      return found.file || !found.problem.empty();
    }));
    return found;
  }
  [[nodiscard]] std::vector<float> means_of(const GaussiansBuffer& model) const {
    std::vector<float> means(model.parameters.begin(),
                             model.parameters.begin() + static_cast<std::ptrdiff_t>(model.count()));
    std::sort(means.begin(), means.end());
    return means;
  }

  GaussiansBuffer model_;
};

TEST_F(Models, AreWhatAnExportWrites) {
  start_with_fake();
  publish();
  const HttpAnswer ply = get(port_, "/model.ply");
  ASSERT_EQ(ply.status, 200) << ply.body;
  EXPECT_EQ(ply.field("Content-Length"), std::to_string(ply.body.size()));
  EXPECT_EQ(ply.field("Content-Disposition"), "attachment; filename=\"model.ply\"");
  EXPECT_THAT(ply.body, StartsWith("ply\n"));
  const splats::SplatFile read = splats::read_file(write("got.ply", ply.body));
  EXPECT_TRUE(read.mip);
  EXPECT_EQ(means_of(read.gaussians), means_of(model_));
  const HttpAnswer spz = get(port_, "/model.spz?any=thing");
  ASSERT_EQ(spz.status, 200) << spz.body;
  EXPECT_EQ(splats::read_file(write("got.spz", spz.body)).gaussians.count(), 1500U);
  const HttpAnswer glb = get(port_, "/model.glb");
  ASSERT_EQ(glb.status, 200) << glb.body;
  EXPECT_EQ(glb.field("Content-Type"), "model/gltf-binary");
  EXPECT_THAT(glb.body, StartsWith("glTF"));
}

TEST_F(Models, AreMarkedAsTheModelWasTrained) {
  start_with_fake({{"mip", "false"}});
  publish();
  EXPECT_FALSE(splats::read_file(write("got.ply", get(port_, "/model.ply").body)).mip);
  EXPECT_FALSE(splats::read_file(write("got.spz", get(port_, "/model.spz").body)).mip);
}

TEST_F(Models, APartIsAPartOfTheWhole) {
  start_with_fake();
  publish();
  // Within a second it is the same file; a slow machine may take another one in between.
  EXPECT_TRUE(bus_test::eventually([&] {
    const HttpAnswer whole = get(port_, "/model.ply");
    const std::string etag = whole.field("ETag");
    const HttpAnswer part = get(port_, "/model.ply", "Range: bytes=1000-299999\r\nIf-Range: " + etag + "\r\n");
    return part.status == 206 && part.field("ETag") == etag && part.body == whole.body.substr(1000, 299000) &&
           part.field("Content-Range") == "bytes 1000-" +
                                              std::to_string(std::min<std::size_t>(299999, whole.body.size() - 1)) +
                                              "/" + std::to_string(whole.body.size());
  }));
}

TEST_F(Models, WithoutOneItIsSaidWhy) {
  start_with_fake();
  const HttpAnswer none = get(port_, "/model.ply");
  EXPECT_EQ(none.status, 503);
  EXPECT_THAT(none.body, HasSubstr("no model is published"));
  EXPECT_EQ(none.field("Retry-After"), "1");
}

TEST_F(Models, ATokenIsAskedFor) {
  // printf %s abc | sha256sum
  const std::string tokens = write("tokens", "view ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start_with_fake({{"tokens", tokens}});
  publish();
  for (const char* path : {"/model.ply", "/model.glb", "/model.spz?token=abd"}) {
    EXPECT_EQ(get(port_, path).status, 401) << path;
  }
  EXPECT_EQ(get(port_, "/model.spz?token=abc").status, 200);
  EXPECT_EQ(status("Authorization: Bearer abc\r\n")["gateway"]["exports"], 1);
}

TEST_F(Models, OneFileServesASecondAndOneIsMadeAtATime) {
  gateway::Traffic traffic;
  ModelFiles files(connect("gateway"), 10000, traffic);
  publish();
  const std::int64_t now_ns = 5 * kSecondNs;
  const auto first = wait_for(files, splats::Format::Ply, now_ns).file;
  ASSERT_TRUE(first);
  EXPECT_EQ(files.find(splats::Format::Ply, now_ns + kSecondNs - 1).file, first);
  EXPECT_EQ(traffic.exports, 1U);
  EXPECT_EQ(files.find(splats::Format::Ply, now_ns + kSecondNs).file, nullptr) << "a second later another one is made";
  EXPECT_EQ(files.find(splats::Format::Spz, now_ns + kSecondNs).file, nullptr);
  EXPECT_EQ(traffic.exports, 2U) << "and no third at the same time";
  const auto second = wait_for(files, splats::Format::Ply, now_ns + kSecondNs).file;
  ASSERT_TRUE(second);
  EXPECT_NE(second->etag, first->etag);
}

TEST_F(Models, FilesThatAreStillReadAreBounded) {
  gateway::Traffic traffic;
  ModelFiles files(connect("gateway"), 10000, traffic);
  publish();
  std::vector<std::shared_ptr<const gateway::ModelFile>> read;
  for (std::size_t i = 0; i < ModelFiles::kMaxFiles; ++i) {
    read.push_back(wait_for(files, splats::Format::Spz, static_cast<std::int64_t>(2 * i + 1) * kSecondNs).file);
    ASSERT_TRUE(read.back());
  }
  const std::int64_t later_ns = 100 * kSecondNs;
  EXPECT_THAT(files.find(splats::Format::Spz, later_ns).problem, HasSubstr("too many files"));
  read.pop_back();
  EXPECT_TRUE(wait_for(files, splats::Format::Spz, later_ns).file);
}

TEST_F(Models, OfALargerModelThanMayBeNoneIsMade) {
  gateway::Traffic traffic;
  publish();
  ModelFiles small(connect("gateway"), 1499, traffic);
  EXPECT_THAT(wait_for(small, splats::Format::Ply, 1).problem, HasSubstr("1500 Gaussians, at most 1499"));
  ModelFiles none(connect("gateway-2"), 0, traffic);
  EXPECT_THAT(none.find(splats::Format::Ply, 1).problem, HasSubstr("max_model_gaussians"));
}

}  // namespace
}  // namespace splatbus::gateway_test
