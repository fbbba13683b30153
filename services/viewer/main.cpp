#include <fmt/format.h>

#include <string_view>
#include <vector>

#include "bus/error.h"
#include "bus/service.h"
#include "viewer/standalone.h"
#include "viewer/viewer.h"

namespace {

void run_on_bus(splatbus::bus::ServiceContext& service) {
  std::string endpoint = service.parameters.read<splatbus::viewer::Options>().endpoint;
  const splatbus::bus::Address& address = service.bus->address();
  if (endpoint.empty()) {
    if (!address.is_local()) {
      throw splatbus::bus::Error(
          fmt::format("the bus at {} has no folder: set 'endpoint' to the streamer's", address.text()));
    }
    endpoint = "ipc://" + *address.directory + "/streamer";
  }
  splatbus::viewer::Viewer(service.parameters,
                           {.name = service.bus->source(),
                            .endpoint = endpoint,
                            .device = service.backend,
                            .stop = service.stop,
                            .counter = [&](const std::string& name, double value) { service.counter(name, value); },
                            .detail = [&](const std::string& text) { service.detail(text); }})
      .run();
}

}  // namespace

int main(int argc, char** argv) {
  // Short for --set probe=true and --set window=true.
  std::vector<char*> arguments;
  char set[] = "--set", probe[] = "probe=true", window[] = "window=true";
  bool standalone = false;
  for (int i = 0; i < argc; ++i) {
    const std::string_view argument = argv[i];
    standalone = standalone || argument.starts_with("--connect");
    if (argument == "--probe" || argument == "--window") {
      arguments.push_back(set);
      arguments.push_back(argument == "--probe" ? probe : window);
    } else {
      arguments.push_back(argv[i]);
    }
  }
  const auto count = static_cast<int>(arguments.size());
  if (standalone) return splatbus::viewer::standalone_main(count, arguments.data());
  const splatbus::bus::ServiceDescription description{
      .kind = "viewer",
      .summary =
          "Keeps a replica of the Gaussian model and shows it. Also: --probe, --window; and --connect ENDPOINT to "
          "view a streamer elsewhere without any bus",
      .parameters = splatbus::bus::Parameters::declare<splatbus::viewer::Options>(),
  };
  return splatbus::bus::service_main(count, arguments.data(), description, run_on_bus);
}
