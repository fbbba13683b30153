#include "record.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "bus/heartbeat_thread.h"
#include "bus/log_sink.h"
#include "bus_probe.h"
#include "mcap/reader.h"
#include "recorder.h"
#include "supervised_run.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
constexpr std::chrono::milliseconds kPatience(50);
constexpr std::chrono::seconds kBusPatience(5);
constexpr std::int64_t kSecondNs = 1'000'000'000;

struct RecordOptions {
  std::string bus, name, path, launch_file;
  std::vector<std::string> topics{"*"}, exclude, payloads;
  double seconds = 0, wait_s = 0;
  std::uint64_t max_mb = 0, buffer_mb = 256;
  bool split = false, json = false;
};

fs::path default_path() {
  return fmt::format("splatbus-{:%Y%m%d-%H%M%S}.mcap", fmt::localtime(std::time(nullptr)));
}

/// "name.mcap", "name-1.mcap", ...
fs::path path_of_part(const fs::path& path, unsigned part) {
  if (part == 0) return path;
  fs::path result = path;
  return result.replace_filename(fmt::format("{}-{}{}", path.stem().string(), part, path.extension().string()));
}

std::vector<mcap::Metadata> metadata_of(const RecordOptions& options, const bus::Address& address) {
  std::vector<mcap::Metadata> all{
      {.name = kRecordingMetadata,
       .values = {{"splatbus", SPLATBUS_VERSION},
                  {"bus", address.text()},
                  {"clock", "log_time and publish_time: ns since 1970; header times: CLOCK_MONOTONIC, ns"},
                  {"realtime_minus_monotonic_ns", std::to_string(realtime_minus_monotonic_ns())}}}};
  if (options.launch_file.empty()) return all;
  std::ifstream file(options.launch_file, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) throw std::runtime_error(fmt::format("{}: cannot be read", options.launch_file));
  all.push_back({.name = kLaunchMetadata, .values = {{"path", options.launch_file}, {"text", text.str()}}});
  return all;
}

RecorderOptions recorder_options(const RecordOptions& options, const fs::path& path, const bus::Address& address) {
  RecorderOptions result;
  result.topics = options.topics;
  result.exclude = options.exclude;
  if (!options.payloads.empty()) {
    result.without_payloads.clear();
    result.payloads = options.payloads;
    if (options.payloads.front() == "all") result.payloads = {"*"};
    if (options.payloads.front() == "none") result.payloads.clear();
  }
  result.queue_bytes = options.buffer_mb << 20;
  result.file = {.writer = {.header = {.profile = "splatbus", .library = "splatbus " SPLATBUS_VERSION}},
                 .metadata = metadata_of(options, address),
                 .max_bytes = options.max_mb << 20,
                 .split = options.split,
                 .open = [path](unsigned part) { return mcap::create_file(path_of_part(path, part)); }};
  return result;
}

/// Says once a second on stderr, in sys/log and in the heartbeat how it goes.
class Reporter {
 public:
  explicit Reporter(bus::ServiceContext& service) : service_(service) {}

  void report(const Recorder::State& state) {
    const TopicRecord total = state.total();
    service_.counter("messages", static_cast<double>(total.messages));
    service_.counter("dropped", static_cast<double>(total.dropped()));
    service_.counter("queued_mb", static_cast<double>(state.queued_bytes) / 1e6);
    service_.counter("file_mb", static_cast<double>(state.file_bytes) / 1e6);
    for (const auto& [topic, record] : state.topics) {
      if (record.dropped() == said_[topic]) continue;
      said_[topic] = record.dropped();
      service_.counter("dropped " + topic, static_cast<double>(record.dropped()));
      spdlog::warn("{}: {} messages are missing so far: {}", topic, record.dropped(), describe_drops(record));
    }
  }

 private:
  bus::ServiceContext& service_;
  std::map<std::string, std::uint64_t> said_;
};

void print_summary(const RecordOptions& options, const fs::path& path, const Recorder::State& state) {
  const TopicRecord total = state.total();
  if (options.json) {
    Json topics = Json::object();
    for (const auto& [topic, record] : state.topics) {
      topics[topic] = {{"messages", record.messages},         {"bytes", record.bytes},
                       {"slow_disk", record.slow_disk},       {"failed_disk", record.failed_disk},
                       {"beyond_limit", record.beyond_limit}, {"overwritten", record.overwritten},
                       {"refused", record.refused},           {"lost", record.lost}};
    }
    fmt::print("{}\n", Json{{"file", path.string()},
                            {"parts", state.parts},
                            {"messages", total.messages},
                            {"dropped", total.dropped()},
                            {"bytes", state.file_bytes},
                            {"most_queued_bytes", state.most_queued_bytes},
                            {"topics", topics}}
                           .dump(-1, ' ', false, Json::error_handler_t::replace));
    return;
  }
  fmt::print("{}{}: {} messages, {:.1f} MB from {:.1f} MB\n", path.string(),
             state.parts > 1 ? fmt::format(" and {} more", state.parts - 1) : "", total.messages,
             static_cast<double>(state.file_bytes) / 1e6, static_cast<double>(total.bytes) / 1e6);
  if (state.full) fmt::print("stopped at the limit of {} MB (--max-mb)\n", options.max_mb);
  for (const auto& [topic, record] : state.topics) {
    if (record.dropped() > 0) fmt::print("missing of {}: {}\n", topic, describe_drops(record));
  }
}

int record(const RecordOptions& options) {
  const StopSignals signals;
  const fs::path path = options.path.empty() ? default_path() : fs::path(options.path);
  const bus::Address address = bus_address(options.bus);
  require_bus(address, std::chrono::duration<double>(options.wait_s), signals.stop());
  const auto context =
      bus::Context::create(address, options.name.empty() ? fmt::format("record-{}", ::getpid()) : options.name);
  if (!context->wait_connected(kBusPatience)) {
    throw std::runtime_error(fmt::format("no bus at {}: is anything launched there?", address.text()));
  }
  Recorder recorder(context, recorder_options(options, path, address));
  bus::install_logger(context, "info");
  bus::Parameters no_parameters(std::vector<bus::ParameterSpec>{});
  bus::ServiceContext service(context, no_parameters, signals.stop());
  std::string failure;
  {
    bus::HeartbeatThread heartbeats(service, "record");
    Reporter reporter(service);
    if (!options.json) fmt::print("recording {} to {}; Ctrl-C ends it\n", address.text(), path.string());
    std::fflush(stdout);
    const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.seconds * 1e9);
    std::int64_t report_ns = bus::now_ns() + kSecondNs;
    while (!signals.stop().stop_requested() && (options.seconds == 0 || bus::now_ns() < end_ns)) {
      if (!recorder.poll(kPatience)) break;
      if (bus::now_ns() < report_ns) continue;
      report_ns = bus::now_ns() + kSecondNs;
      reporter.report(recorder.state());
    }
    service.detail("waits for the disk");
    try {
      recorder.finish();
    } catch (const mcap::Error& error) {
      failure = error.what();
    }
    reporter.report(recorder.state());
    heartbeats.finish(failure.empty() ? wire::ServiceState::Stopping : wire::ServiceState::Failed, failure);
  }
  bus::uninstall_logger();
  print_summary(options, path, recorder.state());
  if (failure.empty()) return 0;
  throw std::runtime_error(
      fmt::format("{}; what was written before can be played, and `splatbus record recover` "
                  "completes the file",
                  failure));
}

int recover(const std::string& path) {
  const mcap::Recovered recovered = mcap::recover(path);
  if (recovered.damage.empty()) {
    fmt::print("{} is complete\n", path);
  } else {
    fmt::print("{} is complete now; {} bytes behind the last whole chunk are gone ({})\n", path, recovered.cut_bytes,
               recovered.damage);
  }
  return 0;
}

}  // namespace

void add_record_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* verb = app.add_subcommand("record", "Record what crosses the bus as an MCAP file, to look at or to play");
  verb->add_option("-o,--output", options->path, "file to write (default: splatbus-DATE-TIME.mcap)");
  verb->add_option("--topics", options->topics, "topics to record; a name that ends in * is a prefix (default: all)")
      ->delimiter(',');
  verb->add_option("--exclude", options->exclude, "topics to leave out; likewise")->delimiter(',');
  verb->add_option("--payloads", options->payloads,
                   "topics whose tensors are recorded: all, none or names (default: all but model/published)")
      ->delimiter(',');
  verb->add_option("--seconds", options->seconds, "how long (default: until Ctrl-C)")->check(CLI::NonNegativeNumber);
  auto* max_mb =
      verb->add_option("--max-mb", options->max_mb, "size of the file at which recording ends (default: none)")
          ->check(CLI::PositiveNumber);
  verb->add_flag("--split", options->split, "with --max-mb: go on with another file (NAME-1.mcap) at that size instead")
      ->needs(max_mb);
  verb->add_option("--buffer-mb", options->buffer_mb,
                   "memory between the bus and the disk; beyond it messages are dropped and counted (default 256)")
      ->check(CLI::Range(8, 65536));
  verb->add_option("--launch", options->launch_file, "launch file to keep in the recording");
  verb->add_option("--wait", options->wait_s, "seconds in which the bus may come to be there (default 0)")
      ->check(CLI::Range(0.0, 86400.0));
  verb->add_option("--name", options->name, "name on the bus (default: record-PID)");
  verb->add_flag("--json", options->json, "print the result as JSON");
  add_bus_option(*verb, options->bus);
  verb->callback([verb, options, &action] {
    if (verb->get_subcommands().empty()) action = [options] { return record(*options); };
  });
  add_record_info_verb(*verb, action);

  auto path = std::make_shared<std::string>();
  CLI::App* recover_verb = verb->add_subcommand("recover", "Complete a recording that a crash has cut short");
  recover_verb->add_option("file", *path, "recording (.mcap)")->required();
  recover_verb->callback([path, &action] { action = [path] { return recover(*path); }; });
}

}  // namespace splatbus::cli
