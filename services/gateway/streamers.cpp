#include "gateway/streamers.h"

#include <spdlog/spdlog.h>

#include <chrono>
#include <utility>

namespace splatbus::gateway {

Streamers::Streamers(const std::shared_ptr<bus::Context>& context, std::string fallback)
    : fixed_({"", std::move(fallback)}), on_bus_(std::make_unique<OnBus>(context, context->address().is_local())) {}

void Streamers::poll(std::int64_t now_ns) {
  if (!on_bus_) return;
  on_bus_->now_ns = now_ns;
  on_bus_->subscriber.dispatch_all(std::chrono::milliseconds(0));
}

stream::StreamerPlace Streamers::choose(std::int64_t now_ns) {
  if (!on_bus_) return fixed_;
  return on_bus_->choice.choose(now_ns).value_or(fixed_);
}

std::optional<stream::StreamerPlace> Streamers::instead_of(const stream::StreamerPlace& place, std::int64_t now_ns) {
  if (!on_bus_ || on_bus_->choice.serves(place)) return std::nullopt;
  return on_bus_->choice.choose(now_ns);
}

bool Streamers::pass_over(const stream::StreamerPlace& place, const std::string& why, std::int64_t now_ns) {
  const bool is_offered = on_bus_ && !place.source.empty();
  const bool is_new = !is_offered || on_bus_->choice.pass_over(place, now_ns);
  if (is_new && log_limiter_.allow()) spdlog::error("streamer {} is passed over: {}", place.source, why);
  return is_offered;
}

std::optional<stream::StreamerPlace> Streamers::better_than(const stream::StreamerPlace& place, std::int64_t now_ns) {
  return on_bus_ ? on_bus_->choice.better_than(place, now_ns) : std::nullopt;
}

}  // namespace splatbus::gateway
