#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <thread>

#include "bus/subscriber.h"
#include "deploy_plan.h"
#include "probe_runner.h"
#include "verbs.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

struct ExportOptions {
  std::string launch_file, folder;
  std::vector<std::string> arguments, overrides, remote;
  std::string backend;
  DeployOptions deploy;
};

using Write = std::string (*)(const DeployPlan&, const DeployOptions&);

int write(const ExportOptions& options, const char* file_name, Write write_text) {
  LaunchFile file = read_launch_file(options.launch_file, parse_arguments(options.arguments));
  for (const std::string& assignment : options.overrides) apply_override(file, assignment);
  set_backend(file, options.backend);
  DeployOptions deploy = options.deploy;
  for (const std::string& entry : options.remote) {
    const std::size_t equals = entry.find('=');
    if (equals == std::string::npos) {
      throw std::runtime_error(fmt::format("--remote '{}': expected NAME=tcp://host:port", entry));
    }
    deploy.remote[entry.substr(0, equals)] = entry.substr(equals + 1);
  }
  const DeployPlan plan = plan_deployment(file, program_directory(), deploy);
  const std::string text = write_text(plan, deploy);
  if (options.folder.empty()) {
    fmt::print("{}", text);
    return 0;
  }
  fs::create_directories(options.folder);
  const fs::path path = fs::path(options.folder) / file_name;
  std::ofstream out(path);
  if (!(out << text) || !out.flush()) throw std::runtime_error(path.string() + " cannot be written");
  fmt::print("{}\n", path.string());
  return 0;
}

void add_format(CLI::App& verb, Action& action, const char* name, const char* summary, const char* file_name,
                Write write_text) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* format = verb.add_subcommand(name, summary);
  format->add_option("launch-file", options->launch_file, "launch file (.yaml)")->required();
  format->add_option("arguments", options->arguments, "name=value: an argument of the launch file");
  format->add_option("-o,--out", options->folder, "folder to write to; else to standard output");
  format->add_option("--set", options->overrides, "service.parameter=value, before the file's; repeatable")
      ->allow_extra_args(false);
  format
      ->add_option(
          "--remote", options->remote,
          "NAME=tcp://host:port: run this service on other machines, where it reaches the bus there; repeatable")
      ->allow_extra_args(false);
  format->add_option("--image", options->deploy.image, "container image with splatbus")->capture_default_str();
  format->add_option("--gateway-port", options->deploy.gateway_port, "port of the gateway")
      ->check(CLI::Range(1, 65535))
      ->capture_default_str();
  format
      ->add_option("--streamer-port", options->deploy.streamer_port,
                   "port of the first streamer; the next has the next")
      ->check(CLI::Range(1, 65000))
      ->capture_default_str();
  add_backend_option(*format, options->backend);
  format->callback([options, file_name, write_text, &action] {
    action = [options, file_name, write_text] { return write(*options, file_name, write_text); };
  });
}

struct HealthOptions {
  std::string bus, source, tcp, http;
  double timeout_s = 5;
};

/// 0 when somebody answers there.
int answers(const HealthOptions& options) {
  const bool is_tcp = !options.tcp.empty();
  const Probe probe{.kind = is_tcp ? Probe::Kind::Tcp : Probe::Kind::Http,
                    .mark = {},
                    .target = is_tcp ? options.tcp : options.http,
                    .command = {},
                    .period_s = options.timeout_s,
                    .timeout_s = options.timeout_s,
                    .failures = 1};
  const ProbeRunner asking(probe);
  while (!asking.was_good() && !asking.fails()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  if (!asking.was_good()) throw std::runtime_error(fmt::format("{} is not healthy", probe.target));
  fmt::print("{} answers\n", probe.target);
  return 0;
}

/// 0 when the source, or with no name the bus itself, is alive as the broker sees it. The broker does not list itself.
int health(const HealthOptions& options) {
  if (!options.tcp.empty() || !options.http.empty()) return answers(options);
  const bool of_bus = options.source.empty() || options.source == "bus";
  const bus::Address address = bus_address(options.bus);
  bus::Subscriber subscriber(connect(address));
  std::string said;
  subscriber.on(topics::kLiveness, [&](const wire::Liveness& liveness, const bus::Message& message) {
    if (message.header().resent()) return;  // of a moment ago, or of a broker that is gone
    said = of_bus ? "alive" : "is not on the bus";
    if (liveness.nodes() == nullptr || of_bus) return;
    for (const auto* node : *liveness.nodes()) {
      if (node->source()->string_view() == options.source) said = node->alive() ? "alive" : "is silent, or has ended";
    }
  });
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.timeout_s * 1e9);
  while (said != "alive" && bus::now_ns() < end_ns) subscriber.dispatch_all(std::chrono::milliseconds(50));
  const std::string who = options.source.empty() ? "the bus" : options.source;
  if (said.empty()) throw std::runtime_error(fmt::format("no bus answers at {}", address.text()));
  if (said != "alive") throw std::runtime_error(fmt::format("{} {}", who, said));
  fmt::print("{} is alive\n", who);
  return 0;
}

}  // namespace

void add_deploy_formats(CLI::App& verb, Action& action) {
  add_format(verb, action, "compose", "Write a launch file as a docker compose file", "compose.yaml", compose_text);
  add_format(verb, action, "kubernetes", "Write a launch file as Kubernetes manifests", "splatbus.yaml",
             kubernetes_text);
}

void add_health_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<HealthOptions>();
  CLI::App* verb = app.add_subcommand(
      "health", "Check that a service is alive: exits with 0 if so, else with 1; for liveness and readiness probes");
  CLI::Option* const name = verb->add_option("name", options->source, "service on the bus; without it the bus itself");
  CLI::Option* const tcp =
      verb->add_option("--tcp", options->tcp, "HOST:PORT: whether somebody listens there")->excludes(name);
  verb->add_option("--http", options->http, "http:// URL: whether that answers with a status of 200 to 399")
      ->check([](const std::string& url) {
        return url.starts_with("http://") ? std::string() : fmt::format("'{}' does not begin with http://", url);
      })
      ->excludes(name)
      ->excludes(tcp);
  verb->add_option("--timeout", options->timeout_s, "seconds to wait for it")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return health(*options); }; });
}

}  // namespace splatbus::cli
