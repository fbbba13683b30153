// A trainer that changes its model and keeps it, and never ends: kept_main BUS_FOLDER WORLD_FOLDER. After each change
// it says its number and when it was, in nanoseconds.
#include <cstdio>
#include <string>

#include "bus/clock.h"
#include "bus/context.h"
#include "kept_script.h"
#include "trainer/world_keeper.h"

int main(int argc, char** argv) {
  using namespace splatbus;
  using namespace splatbus::trainer;
  if (argc != 3) return 2;
  const auto context = bus::Context::create(bus::Address::parse("ipc://" + std::string(argv[1])), "trainer");
  model::PageStore store(context, {}, {.max_gaussians = kKeptGaussians});
  // Room for a few pages: many a commit takes several rounds.
  WorldKeeper keeper(store, {.folder = argv[2], .period_s = 0.05, .staging_bytes = 2U << 20U});
  model::Truth truth;
  for (std::size_t change = 0;; ++change) {
    change_model(change, &store, truth);
    store.add_step(1, 0.001);
    std::printf("%zu %lld\n", change, static_cast<long long>(bus::now_ns()));
    std::fflush(stdout);
    for (const auto end = bus::now_ns() + 15'000'000; bus::now_ns() < end;) keeper.turn();
  }
}
