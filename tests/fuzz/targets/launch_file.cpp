// A launch file, and an override of it.
#include "launch_file.h"

#include "target.h"

namespace cli = splatbus::cli;

SPLATBUS_FUZZ_TARGET(launch_file, bytes) {
  const std::string text(bytes.begin(), bytes.end());
  const std::size_t end = text.find('\0');
  try {
    cli::LaunchFile file = cli::parse_launch_file(text.substr(0, end), "fuzz.yaml");
    if (end != std::string::npos) cli::apply_override(file, text.substr(end + 1));
  } catch (const cli::LaunchError&) {  // refused
  }
}
