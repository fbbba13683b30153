#include "default_launch_file.h"

#include <stdexcept>

#include "launch_plan.h"

namespace splatbus::cli {

std::filesystem::path default_launch_file(const std::string& name) {
  namespace fs = std::filesystem;
  fs::path relative = fs::path("launch") / name;
  if (fs::exists(relative)) return relative;
  const fs::path programs = program_directory();
  for (fs::path folder = programs; folder.has_relative_path(); folder = folder.parent_path()) {
    if (fs::exists(folder / relative)) return folder / relative;
  }
  throw std::runtime_error(relative.string() + " is neither here nor above " + programs.string() + "; give --launch");
}

}  // namespace splatbus::cli
