#pragma once

#include <gtest/gtest.h>
#include <sys/types.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "command.h"
#include "down_if_killed.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// `splatbus up -d` on a bus of its own, and `down` at the end whatever happens.
class OperatedBus : public testing::Test {
 protected:
  ~OperatedBus() override {
    if (is_up_) (void)splatbus_command({"down", "--bus", bus()});
  }

  [[nodiscard]] std::string bus() const { return folder_.address().text(); }
  /// The launch file.
  [[nodiscard]] std::string file() const { return (files_.path() / "day.yaml").string(); }

  Answer run(std::vector<std::string> verb) const {
    verb.insert(verb.end(), {"--bus", bus()});
    return splatbus_command(verb);
  }
  void expect_success(const std::vector<std::string>& verb) const {
    const Answer answer = run(verb);
    EXPECT_TRUE(answer.status.success()) << testing::PrintToString(verb) << testing::PrintToString(answer.lines);
  }

  void up(const std::string& yaml) {
    std::ofstream(file()) << yaml;
    is_up_ = true;
    const Answer answer = run({"up", "-d", file()});
    ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  }

  const PrivateBusFolder folder_, files_;
  const DownIfKilled down_if_killed_{bus()};
  bool is_up_ = false;
};

}  // namespace splatbus::cli
