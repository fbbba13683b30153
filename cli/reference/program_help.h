#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace splatbus::cli {

/// An option or a positional argument of a command.
struct OptionHelp {
  std::vector<std::string> names;  ///< "--bus", "-n"; empty for a positional argument
  std::string value;               ///< what follows it, "TEXT"; empty for a flag
  std::vector<std::string> choices;
  std::string description;
  bool operator==(const OptionHelp&) const = default;
};

struct CommandHelp {
  std::string name;
  std::string description;
  std::vector<OptionHelp> options;
  std::vector<CommandHelp> commands;
};

/// One of a service's parameters, as its --parameters prints it.
struct ParameterHelp {
  std::string name, default_value, description;
};

/// A program beside this one.
struct ProgramHelp {
  CommandHelp command;
  std::vector<ParameterHelp> parameters;
};

/// Read from what a program prints of itself: its --help and its --parameters.
[[nodiscard]] CommandHelp parse_help(const std::string& name, const std::string& text);
[[nodiscard]] std::vector<ParameterHelp> parse_parameters(const std::string& text);

/// Of every program "splatbus-..." in a folder, by name. They are run for it.
[[nodiscard]] std::vector<ProgramHelp> programs_in(const std::filesystem::path& folder);

/// The scripts that complete the command line of `root` and of the programs beside it.
[[nodiscard]] std::string bash_completion(const CommandHelp& root, const std::vector<ProgramHelp>& programs);
[[nodiscard]] std::string zsh_completion(const CommandHelp& root, const std::vector<ProgramHelp>& programs);
[[nodiscard]] std::string fish_completion(const CommandHelp& root, const std::vector<ProgramHelp>& programs);

/// In the macros of man(7). `date` as in "2026-11-23".
[[nodiscard]] std::string man_page(const CommandHelp& root, const std::vector<ProgramHelp>& programs,
                                   const std::string& version, const std::string& date);

}  // namespace splatbus::cli
