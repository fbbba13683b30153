// A trainer that dies: killed_main FOLDER DEVICE CHANGE POINT makes a model, and is killed at that point of that
// change.
#include <signal.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "bus/context.h"
#include "kill_script.h"

int main(int argc, char** argv) {
  using namespace splatbus;
  using namespace splatbus::model;
  if (argc != 5) return 2;
  const auto context = bus::Context::create(bus::Address::parse("ipc://" + std::string(argv[1])), "trainer");
  const auto point = static_cast<ChangePoint>(std::atoi(argv[4]));
  const int killed_in = std::atoi(argv[3]);
  bool armed = killed_in < 0;
  PageStoreOptions options{.max_gaussians = kScriptGaussians};
  options.at_point = [&](ChangePoint at) {
    if (armed && at == point) ::kill(::getpid(), SIGKILL);
  };
  PageStore store(context, {}, options, static_cast<Device>(std::atoi(argv[2])));
  Truth truth;
  for (std::size_t change = 0; change < kScriptChanges; ++change) {
    armed = static_cast<int>(change) == killed_in;
    make_change(change, &store, truth);
  }
  return 0;
}
