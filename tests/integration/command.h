#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "child_process.h"

namespace splatbus::cli {

/// For the programs that a test starts: their log files go with the test program, and none to the user's state folder.
[[nodiscard]] const std::map<std::string, std::string>& test_environment();

/// What a command of the program came to.
struct Answer {
  ExitStatus status;
  std::vector<std::string> lines;  ///< standard output and standard error

  [[nodiscard]] std::vector<nlohmann::json> json() const;  ///< of each line; discarded where it is none
};

/// Runs the program with a command that ends by itself; one that says nothing for a minute counts as failed.
[[nodiscard]] Answer splatbus_command(const std::vector<std::string>& arguments,
                                      const std::string& program = "splatbus");

}  // namespace splatbus::cli
