#include "viewer/model_saver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <optional>

#include "../../bus/log_capture.h"
#include "../streamer/stream_fixture.h"
#include "splats/file.h"

namespace splatbus::stream_test {
namespace {

using namespace std::chrono_literals;
using viewer::ModelSaver;
using viewer::StreamReceiver;

class ModelSaverTest : public StreamTest {
 protected:
  [[nodiscard]] std::string path() const { return directory_.path() + "/model.ply"; }
  /// What it says in the end.
  static std::string outcome(ModelSaver& saver) {
    std::optional<std::string> outcome;
    EXPECT_TRUE(bus_test::eventually([&] { return (outcome = saver.take_outcome()).has_value(); }));
    return outcome.value_or("");
  }
  void wait_for(StreamReceiver& receiver, const std::function<bool(const viewer::Shown&)>& condition) {
    viewer::Shown shown;
    ASSERT_TRUE(bus_test::eventually([&] {
      receiver.wait_for(1ms);
      return (void)receiver.take(shown), condition(shown);
    }));
  }
};

TEST_F(ModelSaverTest, SaysThatThereIsNothingToSave) {
  start_streamer();
  StreamReceiver receiver(client_options("one"));
  ModelSaver saver;
  ASSERT_TRUE(saver.begin(receiver, path()));
  EXPECT_EQ(outcome(saver), "The model is not here yet.");
  EXPECT_FALSE(std::filesystem::exists(path()));
}

TEST_F(ModelSaverTest, SavesTheShadowsOfLamps) {
  start_streamer({{"visibility_hz", "100"}});
  SceneState scene{.light = {.generation = 1}, .objects = {}, .version = 1};
  scene.light.sources = {{.id = 4, .kind = LightKind::Directional, .intensity = glm::vec3(3)}};
  trainer_.publish_scene(scene);
  const GaussiansBuffer model = stream::test::toy_model(1000, 1);
  const std::vector<std::uint32_t> index = trainer_.publish(model);
  StreamReceiver receiver(client_options("one"));
  wait_for(receiver, [](const auto& shown) { return shown.gaussians == 1000 && shown.scene->version == 1; });
  const std::size_t indices = *std::ranges::max_element(index) + 1;
  std::vector<std::uint8_t> rows(2 * indices, 255);
  for (std::size_t i = 0; i < index.size(); ++i) rows[indices + index[i]] = model.parameters[i] > 0 ? 0 : 255;
  trainer_.publish_visibility(rows, trainer_.generation(), 1, {0, 4});
  wait_for(receiver, [](const auto& shown) { return shown.visibility_version == 1; });
  ModelSaver saver;
  ASSERT_TRUE(saver.begin(receiver, path()));
  EXPECT_NE(outcome(saver).find("Gaussians"), std::string::npos);
  const GaussiansBuffer saved = splats::read_file(path()).gaussians;
  ASSERT_GT(saved.count(), 500U);
  const GaussiansView view = saved.view();
  std::size_t lit = 0, shadowless = 0;
  for (std::size_t i = 0; i < saved.count(); ++i) {
    const float x = *view.at(0, i), color = *view.at(ParameterLayout::kOpacityLogit + 1, i);
    if (std::abs(x) < 0.01F) continue;
    lit += x < 0 && color > -1.5F ? 1 : 0;
    shadowless += x > 0 && color > -1.7F ? 1 : 0;
  }
  EXPECT_GT(lit, saved.count() / 3);
  EXPECT_EQ(shadowless, 0U);
}

TEST_F(ModelSaverTest, LogsWhatBecameOfItAtTheEnd) {
  const bus_test::LogCapture log;  // no thread may log while loggers change
  start_streamer();
  trainer_.publish(stream::test::toy_model(1000, 1));
  {
    StreamReceiver receiver(client_options("one"));
    wait_for(receiver, [](const auto& shown) { return shown.gaussians == 1000; });
    ModelSaver saver;
    ASSERT_TRUE(saver.begin(receiver, path()));
  }
  streamer_.reset();
  EXPECT_NE(log.text().find(path() + ": "), std::string::npos) << log.text();
}

}  // namespace
}  // namespace splatbus::stream_test
