#include "bus/command_line.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "bus/nearest.h"

namespace splatbus::bus {
namespace {

std::vector<std::string> verbs_of(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* verb : app.get_subcommands([](const CLI::App*) { return true; })) {
    if (!verb->get_name().empty() && !verb->get_group().empty()) names.push_back(verb->get_name());
  }
  return names;
}

void add_options(const CLI::App& app, std::vector<std::string>& names) {
  for (const CLI::Option* option : app.get_options()) {
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  }
  // Groups of options are nameless apps.
  for (const CLI::App* group : app.get_subcommands([](const CLI::App* a) { return a->get_name().empty(); })) {
    add_options(*group, names);
  }
}

const CLI::Option* find_option(const CLI::App& app, const std::string& name) {
  if (const CLI::Option* option = app.get_option_no_throw(name)) return option;
  for (const CLI::App* group : app.get_subcommands([](const CLI::App* a) { return a->get_name().empty(); })) {
    if (const CLI::Option* option = find_option(*group, name)) return option;
  }
  return nullptr;
}

bool takes_words(const CLI::App& app) {
  return std::ranges::any_of(app.get_options(), [](const CLI::Option* option) { return option->get_positional(); });
}

/// The first word that is no verb or option where it stands, in a message; empty when all of them are.
std::string unknown_word(const CLI::App& app, int argc, const char* const* argv) {
  const CLI::App* verb = &app;
  std::string maybe;  // of what may be a word that the verb takes
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--") break;
    if (word.starts_with("--")) {
      const std::string name = word.substr(0, word.find('='));
      const CLI::Option* option = find_option(*verb, name);
      if (option == nullptr) {
        std::vector<std::string> known;
        add_options(*verb, known);
        const std::string meant = nearest(name, known);
        return fmt::format("unknown option '{}'{}", name,
                           meant.empty() ? "" : fmt::format("; did you mean '{}'?", meant));
      }
      if (option->get_items_expected_max() > 0 && word.find('=') == std::string::npos) ++i;
    } else if (word.starts_with("-")) {
      // "-o FILE"; in "-oFILE" it is in the word.
      const CLI::Option* option = word.size() == 2 ? find_option(*verb, word) : nullptr;
      if (option != nullptr && option->get_items_expected_max() > 0) ++i;
    } else {
      const std::vector<std::string> verbs = verbs_of(*verb);
      if (verbs.empty()) continue;
      const CLI::App* found = nullptr;
      for (const CLI::App* candidate : verb->get_subcommands([](const CLI::App*) { return true; })) {
        if (candidate->get_name() == word) found = candidate;
      }
      if (found == nullptr && takes_words(*verb)) {
        if (maybe.empty() && !nearest(word, verbs).empty())
          maybe = fmt::format("unknown verb '{}'{}", word, suggestion(word, verbs));
        continue;
      }
      if (found == nullptr) return fmt::format("unknown verb '{}'{}", word, suggestion(word, verbs));
      verb = found;
    }
  }
  return maybe;
}

std::string short_number(std::string_view text) {
  double value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value);
  return fmt::format("{:g}", value);
}

/// "--x: Value -1 not in range 0.000000 to 1797...": the library writes bounds with all their digits.
std::string plain(const std::string& text) {
  constexpr std::string_view kValue = "Value ", kRange = " not in range ", kTo = " to ";
  const auto value = text.find(kValue);
  const auto range = text.find(kRange);
  const auto to = range == std::string::npos ? range : text.find(kTo, range + kRange.size());
  if (value == std::string::npos || to == std::string::npos) return text;
  const std::string given = text.substr(value + kValue.size(), range - value - kValue.size());
  const std::string_view all = text;
  const std::string low = short_number(all.substr(range + kRange.size(), to - range - kRange.size()));
  const std::string_view high = all.substr(to + kTo.size());
  constexpr std::size_t kDigitsOfChoice = 40;
  std::string bounds = fmt::format("from {} to {}", low, short_number(high));
  if (high.size() > kDigitsOfChoice) bounds = given == "0" ? "more than 0" : fmt::format("{} or more", low);
  return fmt::format("{}must be {}, not '{}'", all.substr(0, value), bounds, given);
}

}  // namespace

bool is_supervised() {
  return std::getenv("SPLATBUS_SUPERVISED") != nullptr;
}

int exit_status_after(int signal) {
  return signal != 0 && is_supervised() ? 128 + signal : 0;
}

std::optional<int> parse_command_line(CLI::App& app, int argc, const char* const* argv) {
  try {
    app.parse(argc, argv);
    return std::nullopt;
  } catch (const CLI::Success& success) {
    return app.exit(success);
  } catch (const CLI::ParseError& error) {
    std::string text = unknown_word(app, argc, argv);
    if (text.empty())
      text = error.get_name() == "RequiredError" && std::string_view(error.what()).starts_with("A sub")
                 ? "give a verb"
                 : plain(error.what());
    fmt::print(stderr, "{}: {}\nRun with --help for more information.\n", app.get_name(), text);
    return kExitUsage;
  }
}

}  // namespace splatbus::bus
