#pragma once

#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <string>
#include <vector>

#include "verbs.h"

namespace splatbus::cli {

/// Runs a verb with `arguments`, its own name first, and returns what it printed. Throws what it throws.
inline std::string run_verb(void (*add)(CLI::App&, Action&), std::vector<std::string> arguments) {
  CLI::App app;
  Action action;
  add(app, action);
  std::reverse(arguments.begin(), arguments.end());
  app.parse(arguments);
  testing::internal::CaptureStdout();
  try {
    EXPECT_EQ(action(), 0);
  } catch (...) {
    static_cast<void>(testing::internal::GetCapturedStdout());
    throw;
  }
  return testing::internal::GetCapturedStdout();
}

struct Ran {
  int status = 0;
  std::string out, err;
};

/// The same for a verb that may fail: its exit status, and what it printed.
inline Ran run_to_end(void (*add)(CLI::App&, Action&), std::vector<std::string> arguments) {
  CLI::App app;
  Action action;
  add(app, action);
  std::reverse(arguments.begin(), arguments.end());
  app.parse(arguments);
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  Ran ran;
  ran.status = action();
  ran.out = testing::internal::GetCapturedStdout();
  ran.err = testing::internal::GetCapturedStderr();
  return ran;
}

}  // namespace splatbus::cli
