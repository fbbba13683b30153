#include "bus/keys.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "verbs.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

struct KeysOptions {
  std::string name, public_key;
  std::vector<std::string> roles;
  std::string folder;  ///< empty: bus::keys_folder()
};

fs::path folder_of(const KeysOptions& options) {
  return options.folder.empty() ? bus::keys_folder() : fs::path(options.folder);
}

fs::path key_file(const KeysOptions& options) {
  return folder_of(options) / (options.name + ".key");
}

fs::path allow_list(const KeysOptions& options) {
  return folder_of(options) / "allowed";
}

bus::Rights rights_of(const KeysOptions& options) {
  const auto rights = bus::parse_rights(fmt::format("{}", fmt::join(options.roles, ",")));
  if (!rights) throw std::runtime_error("a role must be view, steer, probe or control");
  return *rights;
}

/// Allows a key, in place of what was said of it or of its name.
void allow(const KeysOptions& options, const bus::Key& public_key) {
  const bus::Rights rights = rights_of(options);
  auto keys = bus::read_allow_list(allow_list(options));
  std::erase_if(
      keys, [&](const bus::AllowedKey& known) { return known.public_key == public_key || known.name == options.name; });
  keys.push_back({options.name, public_key, rights});
  bus::write_allow_list(allow_list(options), keys);
  fmt::print("{} may {}\n", options.name, bus::to_text(rights));
}

int make(const KeysOptions& options) {
  // Before anything is written.
  static_cast<void>(rights_of(options));
  if (options.name.find('/') != std::string::npos) throw std::runtime_error("the name must not contain a slash");
  const auto keys = bus::make_key_pair();
  bus::write_key_file(key_file(options), keys);
  fmt::print("{}: keep this file secret\npublic key: {}\n", key_file(options).string(), keys.public_key);
  if (!options.roles.empty()) allow(options, keys.public_key);
  return 0;
}

int list(const KeysOptions& options) {
  std::vector<fs::path> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder_of(options), error)) {
    if (entry.path().extension() == ".key") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  for (const auto& file : files) {
    fmt::print("own     {:<20} {}\n", file.stem().string(), bus::read_key_file(file).public_key);
  }
  for (const auto& key : bus::read_allow_list(allow_list(options))) {
    fmt::print("allowed {:<20} {} {}\n", key.name, key.public_key, bus::to_text(key.rights));
  }
  return 0;
}

int allow_key(KeysOptions options) {
  bus::require_key(options.public_key, "the key");
  if (options.name.empty()) options.name = options.public_key.substr(0, 8);
  allow(options, options.public_key);
  return 0;
}

int revoke(const KeysOptions& options) {
  auto keys = bus::read_allow_list(allow_list(options));
  const auto revoked = std::erase_if(
      keys, [&](const bus::AllowedKey& key) { return key.name == options.name || key.public_key == options.name; });
  if (revoked == 0) throw std::runtime_error(fmt::format("no key '{}' is allowed here", options.name));
  bus::write_allow_list(allow_list(options), keys);
  fmt::print("{} is revoked; open connections close within two seconds\n", options.name);
  return 0;
}

void add_roles(CLI::App& verb, KeysOptions& options, bool required) {
  auto* option =
      verb.add_option("--role", options.roles, "what the key may do: view, steer, probe or control (repeatable)")
          ->check(CLI::IsMember({"view", "steer", "probe", "control"}))
          ->allow_extra_args(false);
  if (required) option->required();
}

}  // namespace

void add_keys_verb(CLI::App& app, Action& action) {
  CLI::App* keys = app.add_subcommand("keys", "Manage keys for network connections and what their owners may do");
  keys->require_subcommand(1);
  auto options = std::make_shared<KeysOptions>();
  keys->add_option("--folder", options->folder,
                   "folder of the keys (default: SPLATBUS_KEYS, else ~/.config/splatbus/keys)");

  CLI::App* verb =
      keys->add_subcommand("new", "Create a key; with --role, allow it here too. A server's key is named 'server'");
  verb->add_option("name", options->name, "name of the key; its file is NAME.key")->required();
  add_roles(*verb, *options, false);
  verb->callback([options, &action] { action = [options] { return make(*options); }; });

  verb = keys->add_subcommand("list", "Print the keys of this folder and those that may connect");
  verb->callback([options, &action] { action = [options] { return list(*options); }; });

  verb = keys->add_subcommand("allow", "Let a public key from elsewhere connect here");
  verb->add_option("key", options->public_key, "64 hexadecimal digits")->required();
  verb->add_option("--name", options->name, "name for the key (default: its first digits)");
  add_roles(*verb, *options, true);
  verb->callback([options, &action] { action = [options] { return allow_key(*options); }; });

  verb = keys->add_subcommand("revoke", "Revoke a key at once");
  verb->add_option("name", options->name, "name of the key, or the public key")->required();
  verb->callback([options, &action] { action = [options] { return revoke(*options); }; });
}

}  // namespace splatbus::cli
