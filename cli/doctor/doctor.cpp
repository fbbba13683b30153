#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "bus/keys.h"
#include "checks.h"
#include "launch_file.h"
#include "launch_plan.h"
#include "log_store.h"
#include "schema_json.h"
#include "terminal.h"
#include "topic_watch.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

struct DoctorOptions {
  std::string bus, launch;
  std::vector<std::string> arguments;
  std::vector<std::uint16_t> ports;
  bool json = false;
};

constexpr std::uint16_t kPagePort = 7680;  // the gateway's default

/// Host and port at the end of "127.0.0.1:7680" or "tcp://*:7600"; port 0 where there is none.
std::pair<std::string, std::uint16_t> host_and_port(const std::string& text) {
  const auto colon = text.rfind(':');
  if (colon == std::string::npos) return {};
  std::uint16_t port = 0;
  const auto [end, error] = std::from_chars(text.data() + colon + 1, text.data() + text.size(), port);
  if (error != std::errc() || end != text.data() + text.size()) return {};
  const auto slashes = text.find("//");
  const std::size_t begin = slashes == std::string::npos ? 0 : slashes + 2;
  return {text.substr(begin, colon - begin), port};
}

void check_ports(const DoctorOptions& options, std::vector<Check>& checks) {
  std::map<std::uint16_t, std::pair<std::string, std::string>> wanted;  // by port: host, and who
  for (const std::uint16_t port : options.ports) wanted[port] = {"127.0.0.1", "--port"};
  if (options.launch.empty()) {
    wanted.try_emplace(kPagePort, "127.0.0.1", "the gateway");
  } else {
    for (const LaunchService& service : read_launch_file(options.launch, parse_arguments(options.arguments)).services) {
      const bool is_gateway = service.program.value.ends_with("gateway");
      if (is_gateway && !service.parameters.contains("http")) wanted.try_emplace(kPagePort, "127.0.0.1", service.name);
      for (const char* name : {"http", "tcp"}) {
        const auto found = service.parameters.find(name);
        if (found == service.parameters.end()) continue;
        const auto [host, port] = host_and_port(found->second.value);
        if (port != 0) wanted[port] = {host, service.name};
      }
    }
  }
  for (const auto& [port, use] : wanted) checks.push_back(check_port(use.first, port, use.second));
}

int doctor(const DoctorOptions& options) {
  const bus::Address bus = bus_address(options.bus);
  const fs::path programs = program_directory();
  std::vector<Check> checks{check_programs(programs), check_page(programs), check_gpu(),           check_egl(),
                            check_shared_memory(),    check_descriptors(),  check_locked_memory(), check_clock(),
                            check_bus_folder(bus),    check_bus(bus)};
  check_ports(options, checks);
  for (Check& check : check_keys(bus::keys_folder())) checks.push_back(std::move(check));
  const fs::path logs = log_folder(bus);
  if (!logs.empty()) checks.push_back(check_disk("logs", logs));
  checks.push_back(check_disk("working folder", fs::current_path()));

  for (const Check& check : checks) {
    if (options.json) {
      print(json_text({{"check", check.name},
                       {"verdict", to_text(check.verdict)},
                       {"found", check.found},
                       {"advice", check.advice}}));
      continue;
    }
    print(fmt::format("{:<5} {:<22} {}", to_text(check.verdict), check.name, check.found));
    if (!check.advice.empty()) print(fmt::format("{:28} -> {}", "", check.advice));
  }
  const bool fails = std::any_of(checks.begin(), checks.end(),
                                 [](const Check& check) { return check.verdict == Check::Verdict::Fail; });
  return fails ? 1 : 0;
}

}  // namespace

void add_doctor_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<DoctorOptions>();
  CLI::App* verb = app.add_subcommand("doctor", "Check whether this machine is ready, and say what to do");
  CLI::Option* const launch = verb->add_option("--launch", options->launch,
                                               "launch file whose ports are checked (default: the gateway's own port)")
                                  ->check(CLI::ExistingFile);
  verb->add_option("arguments", options->arguments, "name=value: an argument of the launch file")->needs(launch);
  verb->add_option("--port", options->ports, "check this TCP port too; repeatable")->check(CLI::Range(1, 65535));
  verb->add_flag("--json", options->json, "print JSON, one object for each check");
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return doctor(*options); }; });
}

}  // namespace splatbus::cli
