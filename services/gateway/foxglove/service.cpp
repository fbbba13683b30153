#include "gateway/foxglove/service.h"

#include <string>
#include <utility>

namespace splatbus::gateway::foxglove {

Service::Service(std::shared_ptr<bus::Context> context, const Options& options)
    : hub_(static_cast<std::size_t>(options.foxglove.clients), options.foxglove.queue_bytes,
           std::to_string(context->epoch())),
      feed_(std::move(context), hub_, options),
      thread_([this](const std::stop_token& stop) { feed_.run(stop); }) {}

}  // namespace splatbus::gateway::foxglove
