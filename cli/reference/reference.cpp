#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdlib>
#include <ctime>

#include "launch_plan.h"
#include "program_help.h"
#include "verbs.h"

namespace splatbus::cli {
namespace {

/// What --help says, of the verbs that it shows.
CommandHelp help_of(CLI::App& app, const std::string& name) {
  // Not help(), which speaks of the verb that was given.
  CommandHelp command = parse_help(name, app.get_formatter()->make_help(&app, name, CLI::AppFormatMode::Normal));
  for (CommandHelp& inner : command.commands) {
    const std::string description = inner.description;
    inner = help_of(*app.get_subcommand(inner.name), inner.name);
    inner.description = description;
  }
  return command;
}

/// Today's, or that of SOURCE_DATE_EPOCH.
std::string date() {
  const char* const epoch = std::getenv("SOURCE_DATE_EPOCH");
  const std::time_t now = epoch != nullptr ? static_cast<std::time_t>(std::atoll(epoch)) : std::time(nullptr);
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  return fmt::format("{:04}-{:02}-{:02}", parts.tm_year + 1900, parts.tm_mon + 1, parts.tm_mday);
}

}  // namespace

void add_reference_verbs(CLI::App& app, Action& action) {
  auto shell = std::make_shared<std::string>();
  CLI::App* completion = app.add_subcommand("completion", "Print the script that completes this command line");
  completion->group("");  // for packages, which install what it prints
  completion->add_option("shell", *shell, "bash, zsh or fish")
      ->required()
      ->check(CLI::IsMember({"bash", "zsh", "fish"}));
  completion->callback([&app, &action, shell] {
    action = [&app, shell] {
      const CommandHelp root = help_of(app, "splatbus");
      const auto programs = programs_in(program_directory());
      const auto& script = *shell == "bash" ? bash_completion : *shell == "zsh" ? zsh_completion : fish_completion;
      fmt::print("{}", script(root, programs));
      return 0;
    };
  });
  CLI::App* man = app.add_subcommand("man", "Print the manual page");
  man->group("");
  man->callback([&app, &action] {
    action = [&app] {
      fmt::print("{}",
                 man_page(help_of(app, "splatbus"), programs_in(program_directory()), app.version().substr(9), date()));
      return 0;
    };
  });
}

}  // namespace splatbus::cli
