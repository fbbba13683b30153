#include "pipeline_watch.h"

#include <utility>

#include "wire/model_generated.h"
#include "wire/stream_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {

PipelineWatch::PipelineWatch(std::shared_ptr<bus::Context> context)
    : subscriber_(std::move(context),
                  {"trainer/stats", "grid/state", "stream/stats", "relight/visibility", "viewer/quality"}) {}

void PipelineWatch::poll(std::chrono::milliseconds timeout) {
  for (auto message = subscriber_.receive(timeout); message;
       message = subscriber_.receive(std::chrono::milliseconds(0))) {
    bus::guarded(*message, [&] { take(*message); });
  }
}

void PipelineWatch::take(const bus::Message& message) {
  if (message.topic() == "trainer/stats") {
    const auto& stats = message.root<wire::TrainerStats>("TrainerStats/1");
    state_.trainer = {.epoch = message.header().epoch(),
                      .step = stats.step(),
                      .views = stats.views(),
                      .gaussians = stats.gaussians(),
                      .optimizer_s = stats.optimizer_s(),
                      .steps_per_s = stats.steps_per_s(),
                      .loss = stats.loss(),
                      .ready_references = stats.ready_references(),
                      .ready_inputs = stats.ready_inputs(),
                      .paused = stats.paused(),
                      .host_copied_bytes = stats.host_copied_bytes()};
  } else if (message.topic() == "grid/state") {
    const auto& grid = message.root<wire::GridState>("GridState/1");
    state_.grid = {.rounds = grid.rounds(),
                   .batches_pending = grid.batches_pending(),
                   .gaussians_inserted = grid.gaussians_inserted()};
  } else if (message.topic() == "stream/stats") {
    const auto& stats = message.root<wire::StreamStats>("StreamStats/1");
    state_.stream = {.viewers = stats.viewers(),
                     .wire_mbps = stats.wire_mbps(),
                     .wire_mbps_mean = stats.wire_mbps_mean(),
                     .wire_mbps_peak = stats.wire_mbps_peak()};
  } else if (message.topic() == "relight/visibility") {
    state_.visibility_generation = message.root<wire::RelightVisibility>("RelightVisibility/1").model_generation();
  } else if (message.topic() == "viewer/quality") {
    const auto& quality = message.root<wire::ViewerQuality>("ViewerQuality/1");
    state_.viewer_quality[quality.probe_id()] = {
        .psnr_db = quality.psnr_db(), .ssim = quality.ssim(), .flip = quality.flip()};
    if (state_.first_picture_ns == 0) state_.first_picture_ns = quality.first_picture_ns();
  }
}

}  // namespace splatbus::cli
