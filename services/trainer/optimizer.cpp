#include "trainer/optimizer.h"

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
  store_.change(work);
  follow_growth();
}

float Optimizer::ema_decay() const {
  const double covered_steps =
      store_.optimizer_s() > 0 ? options_.ema_s * static_cast<double>(store_.step()) / store_.optimizer_s() : 0;
  const double of_time = covered_steps > 1 ? 1 - 1 / covered_steps : 0;
  return std::max(options_.ema_decay, static_cast<float>(of_time));
}

bool Optimizer::apply(const Commands& commands) {
  const auto& relit = commands.visibility;
  if (relit && store_.accepts_visibility(relit->model_generation, relit->count)) set_visibility(*relit);
  const auto is_new = [&](const InsertBatch& batch) { return !store_.holds(batch.epoch, batch.batch); };
  if (std::none_of(commands.inserts.begin(), commands.inserts.end(), is_new)) return false;
  before_change();
  change([&] {
    for (const InsertBatch& batch : commands.inserts) store_.append(batch);
  });
  return true;
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
