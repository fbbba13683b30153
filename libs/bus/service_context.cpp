#include <utility>

#include "bus/service.h"

namespace splatbus::bus {

ServiceContext::ServiceContext(std::shared_ptr<Context> context, Parameters& service_parameters,
                               std::stop_token stop_token, Device service_backend)
    : bus(std::move(context)), parameters(service_parameters), stop(std::move(stop_token)), backend(service_backend) {}

void ServiceContext::counter(const std::string& name, double value) {
  const std::scoped_lock lock(mutex_);
  counters_[name] = value;
}

void ServiceContext::detail(const std::string& text) {
  const std::scoped_lock lock(mutex_);
  detail_ = text;
}

}  // namespace splatbus::bus
