#include "viewer/ui/saved_file.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <ctime>
#include <filesystem>

namespace splatbus::viewer {

std::string new_file(const std::string& folder, const std::string& extension) {
  namespace fs = std::filesystem;
  if (!folder.empty()) fs::create_directories(folder);
  const std::string name = fmt::format("splatbus_{:%Y-%m-%d_%H-%M-%S}", fmt::localtime(std::time(nullptr)));
  fs::path path = fs::path(folder) / (name + extension);
  for (int more = 2; fs::exists(path); ++more) path = fs::path(folder) / fmt::format("{}_{}{}", name, more, extension);
  return path.string();
}

}  // namespace splatbus::viewer
