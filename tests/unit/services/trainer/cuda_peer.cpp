#include "cuda_peer.h"

#include <unistd.h>

#include <algorithm>
#include <iostream>
#include <random>

#include "cuda_model_fixture.h"

namespace splatbus::trainer {

namespace {

void remove(ModelStore& store, const std::vector<std::uint8_t>& dead) {
  const Placed<std::uint8_t> marks(dead, store.memory());
  store.change([&] { store.remove(marks.data()); });
}

void hold(ModelStore& store) {
  store.change([&] { store.append(sample_batch(1, 1, 3000)); });
  std::vector<std::uint8_t> dead(3000);
  for (std::size_t i = 0; i < dead.size(); i += 10) dead[i] = 1;
  remove(store, dead);
  for (int i = 0; i < 7; ++i) store.add_step(1, 0.01);
}

[[noreturn]] void churn(ModelStore& store, std::uint64_t epoch) {
  std::mt19937 random(static_cast<unsigned>(epoch));
  std::vector<std::uint8_t> dead;
  for (std::uint64_t batch = 1;; ++batch) {
    const std::size_t count = std::min(peer_max_gaussians - store.count(), std::size_t{8000});
    store.change([&] { store.append(sample_batch(epoch, batch, count, static_cast<unsigned>(batch))); });
    if (store.count() < peer_max_gaussians) continue;
    if (dead.empty()) std::cout << "ready" << std::endl;
    dead.resize(store.count());
    for (auto& mark : dead) mark = random() % 4 == 0 ? 1 : 0;
    remove(store, dead);
  }
}

}  // namespace

int run_peer(const std::string& role, const std::string& folder) {
  const auto context = bus::Context::create(bus::Address::parse("ipc://" + folder), "trainer");
  ModelStore store(context, {}, 64, peer_max_gaussians, Device::Cuda);
  if (role == "--churn") churn(store, context->epoch());
  hold(store);
  std::cout << "ready" << std::endl;
  for (;;) ::pause();
}

}  // namespace splatbus::trainer
