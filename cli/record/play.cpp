#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "bus/heartbeat_thread.h"
#include "bus/log_sink.h"
#include "bus_probe.h"
#include "keyboard.h"
#include "player.h"
#include "supervised_run.h"
#include "terminal.h"
#include "verbs.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
constexpr std::chrono::seconds kBusPatience(5);

struct PlayVerbOptions {
  std::string bus, name, path, clock = "now";
  std::vector<std::string> remap;
  PlayOptions play;
  double wait_s = 0;
  bool json = false;
};

/// The sources that the bus has heard of late: they speak for themselves.
std::set<std::string> live_sources(const std::shared_ptr<bus::Context>& context) {
  std::set<std::string> sources;
  bool heard = false;
  bus::Subscriber subscriber(context);
  subscriber.on(topics::kLiveness, [&](const wire::Liveness& liveness, const bus::Message&) {
    heard = true;
    if (liveness.nodes() == nullptr) return;
    for (const wire::Node* node : *liveness.nodes()) {
      if (node->alive()) sources.insert(node->source()->str());
    }
  });
  const std::int64_t end_ns = bus::now_ns() + std::chrono::nanoseconds(kBusPatience).count();
  while (!heard && bus::now_ns() < end_ns) subscriber.dispatch_all(std::chrono::milliseconds(50));
  return sources;
}

PlayOptions play_options(const PlayVerbOptions& options, const std::set<std::string>& live) {
  PlayOptions result = options.play;
  result.recorded_clock = options.clock == "recorded";
  for (const std::string& rule : options.remap) {
    const auto sign = rule.find(":=");
    if (sign == std::string::npos || sign == 0 || sign + 2 == rule.size()) {
      throw std::runtime_error(fmt::format("--remap '{}': expected RECORDED:=PLAYED", rule));
    }
    result.remap[rule.substr(0, sign)] = rule.substr(sign + 2);
  }
  // What a bus says of itself, and who was there.
  const bool asked = std::ranges::any_of(result.topics, [](const auto& topic) { return topic.starts_with("sys/"); });
  if (!asked) result.exclude.emplace_back("sys/*");
  result.silent = live;
  return result;
}

std::string live_line(const PlayState& state) {
  return fmt::format("{:8.2f} s  {} messages{}", state.position_s, state.messages,
                     state.paused ? "  paused: space goes on, s or the right arrow plays one message" : "");
}

void print_summary(const PlayVerbOptions& options, const PlayState& state) {
  if (options.json) {
    fmt::print("{}\n", Json{{"messages", state.messages},
                            {"bytes", state.bytes},
                            {"loops", state.loops},
                            {"sources", state.sources},
                            {"without_tensors", state.without_tensors},
                            {"unreadable", state.unreadable},
                            {"most_late_s", static_cast<double>(state.late_ns) / 1e9}}
                           .dump(-1, ' ', false, Json::error_handler_t::replace));
    return;
  }
  fmt::print("played {} messages, {:.1f} MB\n", state.messages, static_cast<double>(state.bytes) / 1e6);
  if (state.without_tensors > 0) {
    fmt::print("not played: {} messages whose tensors were not recorded\n", state.without_tensors);
  }
}

int play(const PlayVerbOptions& options) {
  const StopSignals signals;
  mcap::Reader reader(options.path);
  const bus::Address address = bus_address(options.bus);
  require_bus(address, std::chrono::duration<double>(options.wait_s), signals.stop());
  const auto context =
      bus::Context::create(address, options.name.empty() ? fmt::format("play-{}", ::getpid()) : options.name);
  if (!context->wait_connected(kBusPatience)) {
    throw std::runtime_error(fmt::format("no bus at {}: is anything launched there?", address.text()));
  }
  const PlayOptions settled = play_options(options, live_sources(context));
  bus::install_logger(context, "info");
  if (!reader.damage().empty()) spdlog::warn("plays what is whole of the recording: {}", reader.damage());
  bus::Parameters no_parameters(std::vector<bus::ParameterSpec>{});
  bus::ServiceContext service(context, no_parameters, signals.stop());
  PlayState state;
  {
    bus::HeartbeatThread heartbeats(service, "play");
    Player player(reader, address, settled);
    std::optional<Keyboard> keyboard;
    if (Keyboard::is_there()) {
      keyboard.emplace([&](char key) {
        if (key == ' ') player.toggle_pause();
        if (key == 's' || key == Keyboard::kRight) player.step();
      });
    }
    const bool shows = keyboard && is_terminal(STDERR_FILENO);
    ProgressLine line;
    state = player.run(signals.stop(), [&](const PlayState& now) {
      service.counter("position_s", now.position_s);
      service.counter("messages", static_cast<double>(now.messages));
      service.counter("loops", static_cast<double>(now.loops));
      service.detail(now.paused ? "paused" : "");
      if (shows) line.show(live_line(now));
    });
    keyboard.reset();
    line.finish();
    if (state.unreadable > 0) {
      spdlog::warn("{} messages or chunks could not be played, the first: {}", state.unreadable, state.first_problem);
    }
    heartbeats.finish(wire::ServiceState::Stopping, "");
  }
  bus::uninstall_logger();
  print_summary(options, state);
  if (state.messages > 0) return 0;
  fmt::print(stderr, "splatbus play: nothing of {} was played{}\n", options.path,
             settled.silent.empty() ? ""
                                    : fmt::format("; sources that are on this bus speak for themselves: {}",
                                                  fmt::join(settled.silent, ", ")));
  return 1;
}

}  // namespace

void add_play_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<PlayVerbOptions>();
  PlayOptions& play_options = options->play;
  CLI::App* verb =
      app.add_subcommand("play",
                         "Publish a recording, for services to read as from the processes themselves; in a terminal, "
                         "space pauses and goes on, and s or the right arrow plays one message of a pause");
  verb->add_option("file", options->path, "recording (.mcap)")->required();
  verb->add_option("--rate", play_options.rate, "recorded seconds a second (default 1)")
      ->check(CLI::Range(0.001, 1000.0));
  verb->add_flag("--loop", play_options.loop, "again and again, until Ctrl-C");
  verb->add_option("--start", play_options.start_s,
                   "seconds into the recording to begin at; what was latched comes first")
      ->check(CLI::Range(0.0, 1e6));
  verb->add_option("--duration", play_options.duration_s, "recorded seconds to play (default: to the end)")
      ->check(CLI::Range(0.0, 1e6));
  verb->add_option("--topics", play_options.topics,
                   "topics to play; a name that ends in * is a prefix (default: all but sys/*)")
      ->delimiter(',');
  verb->add_option("--exclude", play_options.exclude, "topics to leave out; likewise")->delimiter(',');
  verb->add_option("--source", play_options.sources,
                   "processes whose messages are played (default: all that are not on this bus themselves)")
      ->delimiter(',');
  verb->add_option("--remap", options->remap, "RECORDED:=PLAYED: play a topic under another name; repeatable")
      ->allow_extra_args(false);
  verb->add_option("--clock", options->clock, "times in headers: now (of this machine) or as recorded (default now)")
      ->check(CLI::IsMember({"now", "recorded"}));
  verb->add_option("--wait", options->wait_s, "seconds in which the bus may come to be there (default 0)")
      ->check(CLI::Range(0.0, 86400.0));
  verb->add_option("--name", options->name, "name on the bus of this command itself (default: play-PID)");
  verb->add_flag("--json", options->json, "print the result as JSON");
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return play(*options); }; });
}

}  // namespace splatbus::cli
