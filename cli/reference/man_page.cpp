#include <fmt/format.h>
#include <fmt/ranges.h>

#include "program_help.h"

namespace splatbus::cli {
namespace {

/// As text of man(7): hyphens that are meant, backslashes, and no line that begins like a request.
std::string text(const std::string& plain) {
  std::string out;
  for (const char c : plain) {
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";
    } else {
      out += c;
    }
  }
  return out.starts_with('.') || out.starts_with('\'') ? "\\&" + out : out;
}

std::string option_items(const std::vector<OptionHelp>& options) {
  std::string items;
  for (const OptionHelp& option : options) {
    std::string value = option.choices.empty() ? option.value : fmt::format("{}", fmt::join(option.choices, "|"));
    std::string head =
        option.names.empty() ? "" : fmt::format("\\fB{}\\fR", text(fmt::format("{}", fmt::join(option.names, ", "))));
    if (!value.empty()) head += fmt::format("{}\\fI{}\\fR", head.empty() ? "" : " ", text(value));
    items += fmt::format(".TP\n{}\n{}\n", head, option.description.empty() ? "\\&" : text(option.description));
  }
  return items;
}

std::string commands_of(const CommandHelp& command, const std::string& path) {
  std::string sections;
  for (const CommandHelp& inner : command.commands) {
    const std::string name = path + " " + inner.name;
    sections += fmt::format(".SS {}\n{}\n", text(name), text(inner.description));
    sections += option_items(inner.options) + commands_of(inner, name);
  }
  return sections;
}

}  // namespace

std::string man_page(const CommandHelp& root, const std::vector<ProgramHelp>& programs, const std::string& version,
                     const std::string& date) {
  std::string page = fmt::format(".TH SPLATBUS 1 {} \"splatbus {}\"\n.SH NAME\nsplatbus", date, version);
  for (const ProgramHelp& program : programs) page += ", " + text(program.command.name);
  page += " \\- turn a live game engine into a stream of 3D Gaussians\n.SH SYNOPSIS\n.B splatbus\n.I verb\n[options]\n";
  page += fmt::format(".SH DESCRIPTION\n{}\n{}.SH VERBS\n", text(root.description), option_items(root.options));
  page += commands_of(root, "splatbus");
  page += ".SH PROGRAMS\nA launch file names them as services.\n";
  for (const ProgramHelp& program : programs) {
    page += fmt::format(".SS {}\n{}\n", text(program.command.name), text(program.command.description));
    page += option_items(program.command.options);
    if (program.parameters.empty()) continue;
    page += ".PP\nParameters, with their defaults:\n";
    for (const ParameterHelp& parameter : program.parameters) {
      page += fmt::format(".TP\n\\fB{}\\fR = {}\n{}\n", text(parameter.name),
                          parameter.default_value.empty() ? "\"\"" : text(parameter.default_value),
                          text(parameter.description));
    }
  }
  page += R"(.SH FILES
.TP
.I /usr/share/splatbus/launch
Launch files that come with the programs.
.TP
.I ~/.config/splatbus/service.env
What the user service splatbus.service launches: SPLATBUS_LAUNCH=FILE.
.SH EXIT STATUS
0 when it did what was asked, 1 when it failed, 2 when the command line is wrong. A service: 78 when what it was
configured with cannot work, so that starting it again would not help; 128 and the number of the signal that ended it, where a
supervisor runs it.
)";
  return page;
}

}  // namespace splatbus::cli
