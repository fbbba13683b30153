#include <gmock/gmock.h>

#include <thread>

#include "record_fixture.h"
#include "run_verb.h"

namespace splatbus::cli {
namespace {

TEST_F(RecordTest, WithoutABusTheVerbsSaySoAtOnce) {
  bus_test::NumberPublisher publisher(connect("tester"), "test/number");
  const auto recorder = record();
  bus_test::publish_number(publisher, 1);
  poll_until(*recorder, "test/number", 1);
  recorder->finish();
  broker_->stop();
  const std::string bus = directory_.address().text(), another = directory_.path() + "/another.mcap";
  const auto error_of = [&](void (*add)(CLI::App&, Action&), std::vector<std::string> arguments) -> std::string {
    arguments.insert(arguments.end(), {"--bus", bus});
    try {
      return "no error, but: " + run_verb(add, std::move(arguments));
    } catch (const std::exception& error) {
      return error.what();
    }
  };
  const std::string said = "no bus at " + bus + ": nothing runs there";
  EXPECT_THAT(error_of(add_play_verb, {"play", path().string()}), testing::StartsWith(said));
  EXPECT_THAT(error_of(add_record_verb, {"record", "-o", another, "--seconds", "1"}), testing::StartsWith(said));
  EXPECT_FALSE(std::filesystem::exists(another));
}

TEST_F(RecordTest, WhoIsToldToWaitsForTheBus) {
  broker_.reset();
  const std::jthread later([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
    broker_ = std::make_unique<bus_service::Broker>(options());
    broker_->start();
  });
  const std::string bus = directory_.address().text();
  EXPECT_THAT(
      run_verb(add_record_verb, {"record", "-o", path().string(), "--seconds", "0.2", "--wait", "60", "--bus", bus}),
      testing::HasSubstr("recording " + bus));
  EXPECT_TRUE(std::filesystem::exists(path()));
}

}  // namespace
}  // namespace splatbus::cli
