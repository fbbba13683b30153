#include "trainer/optimizer.h"

#include <spdlog/spdlog.h>

#include <algorithm>

#include "bus/error.h"
#include "trainer/cpu_optimizer.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "trainer/cuda/cuda_optimizer.h"
#endif

namespace splatbus::trainer {

StepReport& StepReport::operator+=(const StepReport& later) {
  const std::size_t all = views + later.views;
  if (all > 0)
    loss =
        (loss * static_cast<double>(views) + later.loss * static_cast<double>(later.views)) / static_cast<double>(all);
  steps += later.steps;
  views = all;
  seconds += later.seconds;
  return *this;
}

void Optimizer::change(const std::function<void()>& work) {
  try {
    store_.change(work);
  } catch (...) {
    follow_growth();
    throw;
  }
  follow_growth();
}

float Optimizer::average_decay() const {
  const double covered_steps =
      store_.optimizer_s() > 0 ? options_.ema_s * static_cast<double>(store_.step()) / store_.optimizer_s() : 0;
  const double of_time = covered_steps > 1 ? 1 - 1 / covered_steps : 0;
  return std::max(options_.ema_decay, static_cast<float>(of_time));
}

std::vector<const InsertBatch*> Optimizer::admitted(const std::vector<InsertBatch>& inserts) {
  std::vector<const InsertBatch*> batches;
  std::size_t count = store_.count();
  for (const InsertBatch& batch : inserts) {
    if (store_.holds(batch.epoch, batch.batch)) continue;
    const std::size_t grown = count + std::min(batch.count, store_.room(count));
    const std::string lacking = lacks_memory_for(store_.capacity_for(grown));
    if (lacking.empty()) {
      count = grown;
      batches.push_back(&batch);
      continue;
    }
    ++refused_inserts_;
    if (std::exchange(warned_insert_, true)) continue;
    spdlog::error("model: {} Gaussians in batch {} are refused, and so is what follows until there is memory: {}",
                  batch.count, batch.batch, lacking);
  }
  if (!batches.empty()) warned_insert_ = false;
  return batches;
}

bool Optimizer::apply(const Commands& commands) {
  const auto inserts = admitted(commands.inserts);
  if (inserts.empty() && commands.cells.empty() && !commands.visibility) return false;
  const std::uint64_t generation = store_.structure().generation;
  before_change();
  if (commands.visibility) {
    const VisibilityCommand& relit = *commands.visibility;
    store_.set_visibility(relit.model_generation, reinterpret_cast<const float*>(relit.visibility.get()), relit.memory,
                          relit.count);
  }
  if (!inserts.empty() || !commands.cells.empty()) {
    change([&] {
      for (const InsertBatch* batch : inserts) store_.append(*batch);
      for (const CellsCommand& command : commands.cells) store_.set_frozen(command.cells, command.freeze);
    });
  }
  return store_.structure().generation != generation;
}

std::unique_ptr<Optimizer> make_optimizer(ModelStore& store, const Options& options) {
  if (store.memory() == Device::Cpu) return std::make_unique<CpuOptimizer>(store, options);
#ifdef SPLATBUS_HAVE_CUDA
  return make_cuda_optimizer(store, options);
#else
  throw bus::Error("this build cannot train a model in device memory");
#endif
}

}  // namespace splatbus::trainer
