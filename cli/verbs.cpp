#include "verbs.h"

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdlib>

#include "bus_probe.h"

namespace splatbus::cli {

namespace {

/// Of the one verb that runs.
struct BusKeys {
  std::string key, server_key;
} bus_keys;

}  // namespace

void add_bus_option(CLI::App& verb, std::string& address) {
  verb.add_option(
      "--bus", address,
      "bus address, ipc:///folder or tcp://host:port (default: SPLATBUS_BUS, else a folder of the current user)");
  verb.add_option("--key", bus_keys.key,
                  "key file for a bus over tcp, made by 'splatbus keys' (default: SPLATBUS_KEY)");
  verb.add_option("--server-key", bus_keys.server_key, "public key of that bus (default: SPLATBUS_SERVER_KEY)");
}

void add_backend_option(CLI::App& verb, std::string& backend) {
  const bool swaps = verb.get_name() == "swap";  // which starts one process; the others launch services
  verb.add_option("--backend", backend,
                  swaps ? "backend of the new process: cpu, cuda or auto (default: that of the old one)"
                        : "default backend for services that set none: cpu, cuda or auto")
      ->check(CLI::IsMember({"cpu", "cuda", "auto"}));
}

Device own_backend(const std::string& backend) {
  const char* const of_environment = std::getenv("SPLATBUS_BACKEND");
  if (!backend.empty()) return bus::choose_backend(backend);
  return bus::choose_backend(of_environment != nullptr ? of_environment : "auto");
}

bus::Address bus_address(const std::string& option) {
  auto address = option.empty() ? bus::Address::from_environment() : bus::Address::parse(option);
  address.key_file = bus_keys.key;
  address.server_key = bus_keys.server_key;
  return address;
}

std::shared_ptr<bus::Context> connect(const bus::Address& address) {
  require_bus(address);
  return connect_later(address);
}

std::shared_ptr<bus::Context> connect_later(const bus::Address& address) {
  return bus::Context::create(address, fmt::format("cli-{}", getpid()));
}

}  // namespace splatbus::cli
