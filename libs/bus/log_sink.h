#pragma once

#include <memory>

#include "bus/context.h"

namespace splatbus::bus {

/// Makes spdlog's default logger write to stderr, each line with the source's name, and to sys/log from level info on.
/// `level` is one of trace, debug, info, warn, error, off. Throws Error on another.
void install_logger(const std::shared_ptr<Context>& context, const std::string& level);

/// Takes sys/log away again, so that the context can go.
void uninstall_logger();

}  // namespace splatbus::bus
