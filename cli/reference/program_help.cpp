#include "program_help.h"

#include <fmt/format.h>
#include <stdio.h>

#include <algorithm>
#include <array>
#include <memory>
#include <regex>
#include <set>
#include <sstream>

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::istringstream stream(text);
  for (std::string part; std::getline(stream, part, separator);) parts.push_back(part);
  return parts;
}

/// The first column of a line: "--backend TEXT:{cpu,cuda,auto}=auto (Env:SPLATBUS_BACKEND)".
OptionHelp parse_option(const std::string& column) {
  OptionHelp option;
  const std::size_t space = column.find(' ');
  const std::string names = column.substr(0, space);
  if (names.starts_with('-')) option.names = split(names, ',');
  if (space == std::string::npos) return option;
  std::string rest = column.substr(space + 1);
  rest = rest.substr(0, rest.find(" (Env:"));
  if (const std::size_t open = rest.find('{'), close = rest.find('}'); open < close && close != std::string::npos) {
    option.choices = split(rest.substr(open + 1, close - open - 1), ',');
  }
  option.value = option.names.empty() ? names : rest.substr(0, rest.find_first_of(":= "));
  return option;
}

/// What a program prints to its standard output.
std::string output_of(const fs::path& program, const std::string& argument) {
  std::string quoted = program.string();
  for (std::size_t at = quoted.find('\''); at != std::string::npos; at = quoted.find('\'', at + 4)) {
    quoted.replace(at, 1, "'\\''");
  }
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(
      ::popen(fmt::format("'{}' {} 2>/dev/null", quoted, argument).c_str(), "re"), ::pclose);
  if (!pipe) return {};
  std::string text;
  std::array<char, 4096> block{};
  while (const std::size_t bytes = std::fread(block.data(), 1, block.size(), pipe.get()))
    text.append(block.data(), bytes);
  return text;
}

}  // namespace

CommandHelp parse_help(const std::string& name, const std::string& text) {
  CommandHelp command{.name = name};
  // Two spaces, the column, and after two spaces or where the line is full the description, which may go on below.
  static const std::regex row("^  (\\S.*?)(?:  +(\\S.*))?$");
  static const std::regex full_row("^  (-\\S* \\S+) (\\S.*)$");
  static const std::regex more("^ {20,}(\\S.*)$");
  enum { kAbove, kOptions, kCommands, kOther } section = kAbove;
  std::string* description = nullptr;
  for (const std::string& line : split(text, '\n')) {
    std::smatch match;
    if (!line.empty() && line.front() != ' ' && section == kAbove && !line.starts_with("Usage:") &&
        !line.ends_with(':')) {
      command.description += (command.description.empty() ? "" : " ") + line;
    } else if (!line.empty() && line.front() != ' ') {
      if (line.starts_with("Usage:")) continue;
      section = line == "Subcommands:" ? kCommands : kOptions;
      description = nullptr;
    } else if (description != nullptr && std::regex_match(line, match, more)) {
      *description += (description->empty() ? "" : " ") + match[1].str();
    } else if (section == kCommands && std::regex_match(line, match, row)) {
      command.commands.push_back({.name = match[1], .description = match[2]});
      description = &command.commands.back().description;
    } else if (section == kOptions && (std::regex_match(line, match, row))) {
      std::smatch full;
      if (!match[2].matched && std::regex_match(line, full, full_row) && full[2].str().front() != '(') match = full;
      command.options.push_back(parse_option(match[1]));
      command.options.back().description = match[2];
      description = &command.options.back().description;
    }
  }
  return command;
}

std::vector<ParameterHelp> parse_parameters(const std::string& text) {
  static const std::regex head("^(\\w+) = (.*)$");
  std::vector<ParameterHelp> parameters;
  for (const std::string& line : split(text, '\n')) {
    std::smatch match;
    if (std::regex_match(line, match, head)) {
      parameters.push_back({match[1], match[2], {}});
    } else if (!parameters.empty() && line.starts_with("    ")) {
      parameters.back().description += line.substr(4);
    }
  }
  return parameters;
}

std::vector<ProgramHelp> programs_in(const fs::path& folder) {
  std::set<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename();
    const bool is_verb = name == "splatbus-demo";  // of the program itself
    if (name.starts_with("splatbus-") && !is_verb && name.find('.') == std::string::npos) names.insert(name);
  }
  std::vector<ProgramHelp> programs;
  for (const std::string& name : names) {
    ProgramHelp program{parse_help(name, output_of(folder / name, "--help")), {}};
    const bool has_parameters = std::ranges::any_of(program.command.options, [](const OptionHelp& option) {
      return std::ranges::find(option.names, "--parameters") != option.names.end();
    });
    if (has_parameters) program.parameters = parse_parameters(output_of(folder / name, "--parameters"));
    programs.push_back(std::move(program));
  }
  return programs;
}

}  // namespace splatbus::cli
