#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <functional>

#include "program_help.h"

namespace splatbus::cli {
namespace {

/// In single quotes, for a shell.
std::string quoted(std::string text) {
  for (std::size_t at = text.find('\''); at != std::string::npos; at = text.find('\'', at + 4)) {
    text.replace(at, 1, "'\\''");
  }
  return "'" + text + "'";
}

using Visit = std::function<void(const std::string& path, const CommandHelp& command)>;

/// Every command with the words that lead to it: "splatbus topic echo".
void walk(const CommandHelp& command, const std::string& path, const Visit& visit) {
  visit(path, command);
  for (const CommandHelp& inner : command.commands) walk(inner, path + " " + inner.name, visit);
}

std::vector<std::string> parameter_names(const ProgramHelp& program, const std::string& prefix) {
  std::vector<std::string> names;
  for (const ParameterHelp& parameter : program.parameters)
    names.push_back(fmt::format("{}{}=", prefix, parameter.name));
  return names;
}

/// What may follow a --set: parameters of a program, or, of the splatbus program's verbs, of the service named like it.
std::vector<std::string> settings(const std::string& path, const std::vector<ProgramHelp>& programs) {
  const std::string prefix = "splatbus-";
  std::vector<std::string> all;
  for (const ProgramHelp& program : programs) {
    if (program.command.name == path) return parameter_names(program, "");
    const auto names = parameter_names(program, program.command.name.substr(prefix.size()) + ".");
    all.insert(all.end(), names.begin(), names.end());
  }
  return all;
}

std::string word_table(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  std::string table;
  const auto add = [&](const std::string& key, const std::vector<std::string>& words) {
    if (!words.empty())
      table += fmt::format("    {}) echo {} ;;\n", quoted(key), quoted(fmt::format("{}", fmt::join(words, " "))));
  };
  const Visit visit = [&](const std::string& path, const CommandHelp& command) {
    std::vector<std::string> commands, options, with_value;
    for (const CommandHelp& inner : command.commands) commands.push_back(inner.name);
    for (const OptionHelp& option : command.options) {
      options.insert(options.end(), option.names.begin(), option.names.end());
      if (option.value.empty()) continue;
      with_value.insert(with_value.end(), option.names.begin(), option.names.end());
      for (const std::string& name : option.names) {
        add(fmt::format("{}:{}", path, name), name == "--set" ? settings(path, programs) : option.choices);
      }
    }
    add(path + ":commands", commands);
    add(path + ":options", options);
    add(path + ":values", with_value);
  };
  walk(root, root.name, visit);
  for (const ProgramHelp& program : programs) walk(program.command, program.command.name, visit);
  return table;
}

/// Bash's, which zsh reads too.
std::string functions(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  return "_splatbus_words() {\n  case \"$1\" in\n" + word_table(root, programs) + R"sh(  esac
}
_splatbus() {
  local cur="${COMP_WORDS[COMP_CWORD]}" prev="${COMP_WORDS[COMP_CWORD-1]}" path="${COMP_WORDS[0]##*/}" word words i
  for ((i = 1; i < COMP_CWORD; i++)); do
    word="${COMP_WORDS[i]}"
    case " $(_splatbus_words "$path:commands") " in *" $word "*) path="$path $word" ;; esac
  done
  COMPREPLY=()
  words="$(_splatbus_words "$path:$prev")"
  case " $(_splatbus_words "$path:values") " in
    *" $prev "*) ;;
    *) case "$cur" in
         -*) words="$(_splatbus_words "$path:options")" ;;
         *) words="$(_splatbus_words "$path:commands")" ;;
       esac ;;
  esac
  [ -n "$words" ] || return 0
  [ "$prev" != --set ] || compopt -o nospace 2>/dev/null
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
}
)sh";
}

std::string names_of(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  std::string names = root.name;
  for (const ProgramHelp& program : programs) names += " " + program.command.name;
  return names;
}

std::string fish_option(const std::string& program, const std::string& condition, const OptionHelp& option,
                        const std::vector<std::string>& choices) {
  std::string line = fmt::format("complete -c {}{}", program, condition);
  for (const std::string& name : option.names) {
    line += name.starts_with("--") ? " -l " + name.substr(2) : " -s " + name.substr(1);
  }
  if (!option.value.empty())
    line += choices.empty() ? " -r" : fmt::format(" -x -a {}", quoted(fmt::format("{}", fmt::join(choices, " "))));
  return line + fmt::format(" -d {}\n", quoted(option.description));
}

std::string fish_commands(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  std::string script;
  walk(root, root.name, [&](const std::string& path, const CommandHelp& command) {
    const std::string verbs = path.substr(root.name.size());
    std::string seen, names;
    for (const CommandHelp& inner : command.commands) names += " " + inner.name;
    for (std::size_t at = 0; at < verbs.size();) {
      const std::size_t end = std::min(verbs.find(' ', at + 1), verbs.size());
      seen += fmt::format("{}__fish_seen_subcommand_from {}", seen.empty() ? "" : "; and ",
                          verbs.substr(at + 1, end - at - 1));
      at = end;
    }
    const std::string none =
        names.empty() ? seen
                      : fmt::format("{}not __fish_seen_subcommand_from{}", seen.empty() ? "" : seen + "; and ", names);
    const std::string condition = none.empty() ? "" : " -n " + quoted(none);
    for (const CommandHelp& inner : command.commands) {
      script +=
          fmt::format("complete -c {} -f{} -a {} -d {}\n", root.name, condition, inner.name, quoted(inner.description));
    }
    for (const OptionHelp& option : command.options) {
      if (option.names.empty()) continue;
      const bool sets = std::ranges::find(option.names, "--set") != option.names.end();
      script += fish_option(root.name, condition, option, sets ? settings(path, programs) : option.choices);
    }
  });
  return script;
}

}  // namespace

std::string bash_completion(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  return functions(root, programs) + fmt::format("complete -o default -F _splatbus {}\n", names_of(root, programs));
}

std::string zsh_completion(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  std::string script =
      fmt::format("#compdef {}\nautoload -Uz bashcompinit && bashcompinit\n", names_of(root, programs));
  script += functions(root, programs);
  // The file is this function's body until it is first called.
  const std::size_t at = script.find("\n_splatbus() {");
  script.replace(at, 14, "\n_splatbus_bash() {");
  return script + "_bash_complete -o default -F _splatbus_bash\n";
}

std::string fish_completion(const CommandHelp& root, const std::vector<ProgramHelp>& programs) {
  std::string script = fish_commands(root, programs);
  for (const ProgramHelp& program : programs) {
    for (const OptionHelp& option : program.command.options) {
      const bool sets = std::ranges::find(option.names, "--set") != option.names.end();
      script += fish_option(program.command.name, "", option,
                            sets ? settings(program.command.name, programs) : option.choices);
    }
  }
  return script;
}

}  // namespace splatbus::cli
