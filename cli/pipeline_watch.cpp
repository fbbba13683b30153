#include "pipeline_watch.h"

#include <utility>

#include "wire/model_generated.h"
#include "wire/stream_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {

PipelineWatch::PipelineWatch(std::shared_ptr<bus::Context> context) : subscriber_(std::move(context)) {
  using bus::Message;
  subscriber_
      .on(topics::kTrainerStats,
          [this](const wire::TrainerStats& stats, const Message& message) {
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
          })
      .on(topics::kGridState,
          [this](const wire::GridState& grid, const Message&) {
            state_.grid = {.rounds = grid.rounds(),
                           .batches_pending = grid.batches_pending(),
                           .gaussians_inserted = grid.gaussians_inserted()};
          })
      .on(topics::kStreamStats,
          [this](const wire::StreamStats& stats, const Message&) {
            state_.stream = {.viewers = stats.viewers(),
                             .wire_mbps = stats.wire_mbps(),
                             .wire_mbps_mean = stats.wire_mbps_mean(),
                             .wire_mbps_peak = stats.wire_mbps_peak()};
          })
      .on(topics::kRelightVisibility,
          [this](const wire::RelightVisibility& visibility, const Message&) {
            state_.visibility_generation = visibility.model_generation();
          })
      .on(topics::kViewerQuality, [this](const wire::ViewerQuality& quality, const Message&) {
        state_.viewer_quality[quality.probe_id()] = {
            .psnr_db = quality.psnr_db(), .ssim = quality.ssim(), .flip = quality.flip()};
        if (state_.first_picture_ns == 0) state_.first_picture_ns = quality.first_picture_ns();
      });
}

void PipelineWatch::poll(std::chrono::milliseconds timeout) {
  subscriber_.dispatch_all(timeout);
}

}  // namespace splatbus::cli
