#include "private_pipeline.h"

#include <stdexcept>
#include <utility>

#include "control_request.h"
#include "operator_verbs.h"
#include "swap_verb.h"
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

PrivatePipeline::~PrivatePipeline() {
  if (control_) control_->stop();  // its verbs refer to what goes before it
}

void PrivatePipeline::start(const LaunchPlan& plan, const LaunchFile& file) {
  control_.emplace(address_);
  logs_.emplace(logs_folder_.path());
  run_.emplace(plan, log_, [this](const OutputLine& line) {
    logs_->write(line);
    control_->publish_line(event_json(line));
  });
  const auto operated = std::make_shared<Operated>(Operated{.supervisor = run_->supervisor(),
                                                            .file = file,
                                                            .bus = address_,
                                                            .log_folder = logs_folder_.path().string(),
                                                            .stop = [down = down_]() mutable { down.request_stop(); }});
  add_operator_verbs(*control_, operated);
  add_swap_handler(*control_, operated);
  control_->start();
}

void PrivatePipeline::stop() {
  if (control_) control_->stop();  // what its verbs refer to goes
  run_->stop();
}

void PrivatePipeline::poll(std::chrono::milliseconds timeout) {
  run_->check();
  if (signals_.stop().stop_requested()) throw std::runtime_error("interrupted");
  if (down_.stop_requested()) throw std::runtime_error("ended by 'splatbus down'");
  watch_.poll(timeout);
  live_.poll(std::chrono::milliseconds(0));
}

}  // namespace splatbus::cli
