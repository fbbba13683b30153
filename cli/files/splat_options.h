#pragma once

#include <cstddef>
#include <string>

#include "splats/file.h"

namespace CLI {
class App;
}

namespace splatbus::cli {

/// Adds --axes to a verb, or the like under another name.
void add_axes_option(CLI::App& verb, splats::Axes& axes, const std::string& name = "--axes");
/// Adds --axes and --spz-version to a verb that writes a model to a file.
void add_write_options(CLI::App& verb, splats::WriteOptions& options);
/// Says what has been written.
void print_written(const std::string& path, std::size_t gaussians, bool json);

}  // namespace splatbus::cli
