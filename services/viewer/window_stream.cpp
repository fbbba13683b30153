#include "viewer/window_stream.h"

#include <exception>
#include <utility>

#include "viewer/ui/saved_file.h"
#include "viewer/ui/texts.h"

namespace splatbus::viewer {
namespace {

constexpr std::int64_t kFiguresNs = 250'000'000;

}  // namespace

WindowStream::WindowStream(Window& window, StreamReceiver& receiver, std::string folder, std::size_t max_gaussians,
                           std::uint32_t max_kbps)
    : window_(window),
      receiver_(receiver),
      folder_(std::move(folder)),
      max_gaussians_(max_gaussians),
      max_kbps_(max_kbps) {
  window_.offer_stream(max_gaussians, max_kbps);
  window_.save_in(folder_);
}

void WindowStream::turn(std::int64_t now_ns, const Painter& painter, std::size_t held, std::int64_t scene_arrived_ns) {
  apply_budget();
  save();
  if (now_ns - figures_ns_ < kFiguresNs) return;
  figures_ns_ = now_ns;
  show_figures(now_ns, painter, held, scene_arrived_ns);
}

void WindowStream::apply_budget() {
  const Settings& settings = window_.settings();
  if (settings.max_gaussians == max_gaussians_ && settings.max_kbps == max_kbps_) return;
  max_gaussians_ = settings.max_gaussians;
  max_kbps_ = settings.max_kbps;
  receiver_.set_budget(max_gaussians_, max_kbps_);
}

void WindowStream::save() {
  if (const auto outcome = saver_.take_outcome()) window_.say(*outcome);
  const auto extension = window_.take_save();
  if (!extension) return;
  try {
    window_.say(saver_.begin(receiver_, new_file(folder_, *extension)) ? texts::kSaving : texts::kStillSaving);
  } catch (const std::exception& error) {
    window_.say(error.what());
  }
}

void WindowStream::show_figures(std::int64_t now_ns, const Painter& painter, std::size_t held,
                                std::int64_t scene_arrived_ns) {
  const ReceiverStatus status = receiver_.status();
  rate_.add(now_ns, status.received_bytes);
  StreamFigures stream{.connected = status.connected,
                       .megabits = rate_.megabits(),
                       .max_kbps = max_kbps_,
                       .round_trip_ms = status.round_trip_ms,
                       .missing_pages = status.missing_pages};
  if (scene_arrived_ns > 0) stream.age_ms = static_cast<double>(now_ns - scene_arrived_ns) / 1e6;
  Figures figures{.held = held, .stream = stream};
  if (held > 0 && window_.shows_figures()) figures.drawn = painter.drawn();
  window_.set_figures(figures);
  window_.keep_saying(held == 0          ? status.connected ? texts::kWaiting : texts::kConnecting
                      : status.connected ? ""
                                         : texts::kReconnecting);
}

}  // namespace splatbus::viewer
