#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "bus/log_sink.h"
#include "bus/rights.h"

namespace splatbus::bus {

/// A CURVE key, in 64 hexadecimal digits.
using Key = std::string;
inline constexpr std::size_t key_bytes = 32;

struct KeyPair {
  Key public_key, secret_key;
};

/// Throws Error naming `what` when the text is no key.
void require_key(const std::string& text, const std::string& what);

[[nodiscard]] KeyPair make_key_pair();

/// Where keys are kept when nothing else is said: SPLATBUS_KEYS, else splatbus/keys in XDG_CONFIG_HOME or ~/.config.
/// There a server's own key is `server.key` and its allow-list `allowed`.
[[nodiscard]] std::filesystem::path keys_folder();

/// Writes a new file that only its owner can read, in a folder made with mode 0700. Throws Error; also when there is
/// one already.
void write_key_file(const std::filesystem::path& file, const KeyPair& keys);

/// Throws Error: it cannot be read, is another user's or readable by others, or holds no matching pair.
[[nodiscard]] KeyPair read_key_file(const std::filesystem::path& file);

/// A line of an allow-list: "NAME PUBLICKEY ROLES".
struct AllowedKey {
  std::string name;  ///< 1 to 64 letters, digits, dots, dashes and underscores
  Key public_key;
  Rights rights;
};

/// Empty when there is no such file. Throws Error as read_key_file does, and for a line that makes no sense.
[[nodiscard]] std::vector<AllowedKey> read_allow_list(const std::filesystem::path& file);

/// Replaces the file in one step. Throws Error.
void write_allow_list(const std::filesystem::path& file, const std::vector<AllowedKey>& keys);

/// Who may do what, by a file that is read again when it changes. Where it cannot be read, nobody may do anything, and
/// the log says so. Thread-safe.
class AllowList {
 public:
  explicit AllowList(std::filesystem::path file);

  /// By the file as it was at most 200 ms ago: for each message.
  [[nodiscard]] Rights rights_of(const Key& public_key);

  /// By the file as it is: for who comes in, so that what was just allowed holds. Asks the file system each time.
  [[nodiscard]] Rights rights_now(const Key& public_key);

 private:
  [[nodiscard]] Rights find(const Key& public_key) const;
  void refresh();

  const std::filesystem::path file_;
  std::mutex mutex_;
  std::map<Key, Rights> rights_;
  std::string stamp_;  ///< of the file as it was read
  std::int64_t checked_ns_ = 0;
};

}  // namespace splatbus::bus
