#include "private_pipeline.h"

#include <stdexcept>
#include <utility>

#include "verbs.h"

namespace splatbus::cli {

PrivatePipeline::PrivatePipeline(const StopSignals& signals, std::filesystem::path log,
                                 const std::optional<bus::Address>& elsewhere)
    : signals_(signals),
      log_(std::move(log)),
      address_(elsewhere ? *elsewhere : folder_.address()),
      context_(connect_later(address_)),
      watch_(context_),
      live_(context_) {}

void PrivatePipeline::poll(std::chrono::milliseconds timeout) {
  run_->check();
  if (signals_.stop().stop_requested()) throw std::runtime_error("interrupted");
  watch_.poll(timeout);
  live_.poll(std::chrono::milliseconds(0));
}

}  // namespace splatbus::cli
