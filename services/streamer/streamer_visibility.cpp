// How much Gaussians see of the lights: from relight to viewers.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <functional>
#include <utility>

#include "bus/trace.h"
#include "streamer/streamer.h"
#include "wire/model_generated.h"

namespace splatbus::streamer {

namespace {

constexpr std::size_t kMaxRelit = 4;  // generations of the model

}  // namespace

// Which of them is of the model that viewers hold shows at the next tick: relight may be ahead of it.
void Streamer::take_visibility(const wire::RelightVisibility& body, const bus::Message& message) {
  const std::uint64_t generation = body.model_generation(), version = body.scene_version();
  const bus::TracedWork work("take visibility", 0, version);
  const bool is_part = body.parts() > 0;
  if (generation < observed_generation_) return;
  // Another replica may be ahead of this one; each page has the newest of its own.
  if (!is_part && version < model_.status().visibility_version) return;
  if (const auto newest = relit_.find(generation);
      !is_part && newest != relit_.end() && newest->second.scene_version > version) {
    return;
  }
  if (body.count() > stream::kMaxModelGaussians) {
    throw bus::Error(fmt::format("relight/visibility: of {} Gaussians, at most {} can be read", body.count(),
                                 stream::kMaxModelGaussians));
  }
  const auto& lights = *body.light_ids();
  if (lights.size() == 0 || lights.size() > 1 + kMaxLightSources || lights.Get(0) != 0 ||
      std::ranges::adjacent_find(lights, std::greater_equal<>{}) != lights.end()) {
    throw bus::Error(fmt::format("relight/visibility: its {} light_ids are not 0 and ascending", lights.size()));
  }
  const auto tensor =
      message.tensor("visibility", bus::ElementType::U8, {lights.size(), static_cast<std::uint32_t>(body.count())});
  if (!tensor) return;
  std::vector<std::uint8_t> of_index(tensor->bytes());
  if (!tensor->copy(of_index.data())) return;
  if (is_part) {
    merge_visibility(body, of_index);
  } else {
    relit_[generation] = {.scene_version = version,
                          .light_ids = {lights.begin(), lights.end()},
                          .of_index = std::move(of_index),
                          .covered = {}};
  }
  if (relit_.size() > kMaxRelit) relit_.erase(relit_.begin());
}

void Streamer::merge_visibility(const wire::RelightVisibility& body, const std::vector<std::uint8_t>& part) {
  const std::size_t count = body.count(), page_indices = body.page_indices();
  if (page_indices == 0) throw bus::Error("relight/visibility: a part without page_indices");
  const std::size_t pages = (count + page_indices - 1) / page_indices;
  const std::vector<std::uint32_t> lights(body.light_ids()->begin(), body.light_ids()->end());
  Visibility& relit = relit_[body.model_generation()];
  if (relit.light_ids != lights || relit.of_index.size() != part.size()) {
    if (body.scene_version() < relit.scene_version) return;
    relit = {.scene_version = body.scene_version(),
             .light_ids = lights,
             .of_index = std::vector<std::uint8_t>(part.size(), 255),
             .page_indices = body.page_indices(),
             .covered = std::vector<std::uint8_t>(pages, 0),
             .version_of_page = std::vector<std::uint64_t>(pages, 0)};
  } else if (relit.covered.empty() || relit.page_indices != page_indices) {
    relit.page_indices = body.page_indices();
    relit.covered.assign(pages, 1);
    relit.version_of_page.assign(pages, relit.scene_version);
  }
  if (body.pages() == nullptr) return;
  for (const std::uint32_t page : *body.pages()) {
    if (page >= pages || body.scene_version() < relit.version_of_page[page]) continue;
    relit.version_of_page[page] = body.scene_version();
    relit.covered[page] = 1;
    const std::size_t first = page * page_indices, length = std::min(page_indices, count - first);
    for (std::size_t light = 0; light < lights.size(); ++light) {
      std::copy_n(part.begin() + static_cast<std::ptrdiff_t>(light * count + first), length,
                  relit.of_index.begin() + static_cast<std::ptrdiff_t>(light * count + first));
    }
    relit.sent = false;
  }
  relit.scene_version = std::max(relit.scene_version, body.scene_version());
}

void Streamer::send_visibility(std::int64_t now_ns) {
  const double bytes_per_s = options_->visibility_kbps * 125;
  visibility_balance_bytes_ = std::min(
      visibility_balance_bytes_ + bytes_per_s * static_cast<double>(now_ns - visibility_ns_) / 1e9, bytes_per_s / 2);
  visibility_ns_ = now_ns;
  relit_.erase(relit_.begin(), relit_.lower_bound(observed_generation_));
  const auto relit = relit_.find(observed_generation_);
  if (relit == relit_.end() || relit->second.sent || !model_.status().ready) return;
  if (now_ns < next_visibility_ns_ || visibility_balance_bytes_ < 0) return;
  next_visibility_ns_ = now_ns + static_cast<std::int64_t>(1e9 / options_->visibility_hz);
  relit->second.sent = true;
  try {
    auto packets = model_.take_visibility({.light_ids = relit->second.light_ids,
                                           .of_index = relit->second.of_index,
                                           .scene_version = relit->second.scene_version,
                                           .page_indices = relit->second.page_indices,
                                           .covered = relit->second.covered},
                                          visibility_balance_bytes_);
    relit->second.sent = model_.visibility_rests();
    for (const auto& packet : packets) visibility_balance_bytes_ -= static_cast<double>(packet.packet.bytes());
    sharing_.publish_visibility(packets);
    hub_.add_visibility(std::move(packets));
  } catch (const stream::StreamError& error) {
    if (log_limiter_.allow()) spdlog::error("{}", error.what());
  }
}

}  // namespace splatbus::streamer
