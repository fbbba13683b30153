#include "verbs.h"

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdlib>

namespace splatbus::cli {

void add_bus_option(CLI::App& verb, std::string& address) {
  verb.add_option("--bus", address,
                  "bus address, ipc:///folder or tcp://host:port (default: SPLATBUS_BUS, else a folder of this user)");
}

void add_backend_option(CLI::App& verb, std::string& backend) {
  verb.add_option("--backend", backend,
                  "cpu, cuda or auto, for every service that the launch file gives none of its own")
      ->check(CLI::IsMember({"cpu", "cuda", "auto"}));
}

Device own_backend(const std::string& backend) {
  const char* const of_environment = std::getenv("SPLATBUS_BACKEND");
  if (!backend.empty()) return bus::choose_backend(backend);
  return bus::choose_backend(of_environment != nullptr ? of_environment : "auto");
}

bus::Address bus_address(const std::string& option) {
  return option.empty() ? bus::Address::from_environment() : bus::Address::parse(option);
}

std::shared_ptr<bus::Context> connect(const bus::Address& address) {
  return bus::Context::create(address, fmt::format("cli-{}", getpid()));
}

}  // namespace splatbus::cli
