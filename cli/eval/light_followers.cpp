#include "light_followers.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <thread>

#include "bus/clock.h"
#include "launch_plan.h"
#include "schema_json.h"
#include "viewer/stream_client.h"

namespace splatbus::cli {

namespace {

using namespace std::chrono_literals;

constexpr std::size_t kGroup = 25;  // of one process
constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::chrono::milliseconds kTurn = 20ms;

void say_whole(const std::vector<std::unique_ptr<viewer::StreamClient>>& clients) {
  const auto whole = std::ranges::count_if(clients, [](const auto& client) {
    return client->replica().pages() > 0 && client->replica().missing_pages() == 0;
  });
  fmt::print("{}\n", json_text({{"whole", whole}}));
  std::fflush(stdout);
}

}  // namespace

void run_light_followers(const std::string& endpoint, std::size_t count, const StopSignals& signals) {
  std::vector<std::unique_ptr<viewer::StreamClient>> clients;
  for (std::size_t i = 0; i < count; ++i) {
    clients.push_back(std::make_unique<viewer::StreamClient>(
        viewer::ClientOptions{.endpoint = endpoint, .name = fmt::format("follower-{}-{}", ::getpid(), i + 1)}));
  }
  std::int64_t said_ns = bus::now_ns();
  while (!signals.stop().stop_requested()) {
    const auto next = std::chrono::steady_clock::now() + kTurn;
    for (const auto& client : clients) {
      client->poll(0ms);
      static_cast<void>(client->take_changes());
    }
    if (bus::now_ns() - said_ns > kSecond) {
      said_ns = bus::now_ns();
      say_whole(clients);
    }
    std::this_thread::sleep_until(next);
  }
}

void LightFollowers::grow_to(std::size_t count) {
  while (count_ < count) {
    const std::size_t more = std::min(kGroup, count - count_);
    groups_.push_back({ChildProcess(program_directory() / "splatbus",
                                    {"eval", "followers", "--connect", endpoint_, "--count", std::to_string(more)}, {}),
                       0});
    count_ += more;
  }
}

std::size_t LightFollowers::whole() {
  std::size_t whole = 0;
  for (Group& group : groups_) {
    const std::vector<std::string> lines = group.process.read_lines(false);
    if (const auto exit = group.process.poll_exit()) {
      throw std::runtime_error(
          fmt::format("viewers that only follow: {}{}", exit->text(), lines.empty() ? "" : "\n  " + lines.back()));
    }
    for (const std::string& line : lines) {
      const auto said = nlohmann::json::parse(line, nullptr, false);
      if (said.is_object() && said.contains("whole")) group.whole = said["whole"].get<std::size_t>();
    }
    whole += group.whole;
  }
  return whole;
}

}  // namespace splatbus::cli
