#include "bus/keys.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zmq.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <sstream>
#include <string_view>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/file_descriptor.h"
#include "bus/frames.h"
#include "bus/permanent_error.h"

namespace splatbus::bus {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t key_digits = 2 * key_bytes;
constexpr std::size_t z85_room = 41;
constexpr std::size_t max_file_bytes = std::size_t{1} << 20;
constexpr std::size_t max_name = 64;
constexpr std::int64_t check_every_ns = 200'000'000;

[[noreturn]] void refuse(const fs::path& file, const std::string& why) {
  throw PermanentError(fmt::format("{}: {}", file.string(), why));
}

Key hex_of_z85(const char* z85) {
  std::array<std::uint8_t, key_bytes> bytes{};
  if (zmq_z85_decode(bytes.data(), z85) == nullptr) throw Error("libzmq made an invalid key");
  Key key;
  for (const std::uint8_t byte : bytes) key += fmt::format("{:02x}", byte);
  return key;
}

std::string z85_of_hex(const Key& key) {
  std::array<std::uint8_t, key_bytes> bytes{};
  for (std::size_t i = 0; i < key_bytes; ++i) {
    bytes[i] = static_cast<std::uint8_t>(std::stoul(key.substr(2 * i, 2), nullptr, 16));
  }
  std::array<char, z85_room> text{};
  zmq_z85_encode(text.data(), bytes.data(), key_bytes);
  return text.data();
}

bool is_key(std::string_view text) {
  return text.size() == key_digits &&
         std::all_of(text.begin(), text.end(), [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

bool is_name(std::string_view text) {
  return !text.empty() && text.size() <= max_name && std::all_of(text.begin(), text.end(), [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '.' || c == '-' ||
           c == '_';
  });
}

// Of a file that is this user's alone; checked on the open file, so that nobody changes it in between.
std::string read_private(const fs::path& file, struct stat& status) {
  const FileDescriptor fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  if (!fd.valid() || ::fstat(fd.get(), &status) != 0) refuse(file, std::strerror(errno));
  if (!S_ISREG(status.st_mode)) refuse(file, "it is not a file");
  if (status.st_uid != ::geteuid()) refuse(file, fmt::format("it belongs to another user ({})", status.st_uid));
  if ((status.st_mode & 077U) != 0) refuse(file, "others can read or write it: its mode must be 0600");
  std::string text;
  char buffer[4096];
  for (ssize_t n = 0; (n = ::read(fd.get(), buffer, sizeof(buffer))) > 0;) {
    text.append(buffer, static_cast<std::size_t>(n));
    if (text.size() > max_file_bytes) refuse(file, "it is too large");
  }
  return text;
}

void write_private(const fs::path& file, const std::string& text) {
  const FileDescriptor fd(::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!fd.valid()) refuse(file, std::strerror(errno));
  if (::write(fd.get(), text.data(), text.size()) != static_cast<ssize_t>(text.size()) || ::fsync(fd.get()) != 0) {
    refuse(file, std::strerror(errno));
  }
}

void make_folder(const fs::path& folder) {
  std::error_code ignored;
  fs::create_directories(folder.parent_path(), ignored);
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) refuse(folder, std::strerror(errno));
}

std::vector<AllowedKey> parse_allow_list(const fs::path& file, const std::string& text) {
  std::vector<AllowedKey> keys;
  std::istringstream lines(text);
  std::string line;
  for (int number = 1; std::getline(lines, line); ++number) {
    if (line.empty() || line.front() == '#') continue;
    std::istringstream words(line);
    AllowedKey key;
    std::string roles, surplus;
    words >> key.name >> key.public_key >> roles;
    const auto rights = parse_rights(roles);
    if (!is_name(key.name) || !is_key(key.public_key) || !rights || !rights->any() || words >> surplus) {
      refuse(file, fmt::format("line {}: expected NAME PUBLICKEY ROLES", number));
    }
    key.rights = *rights;
    keys.push_back(std::move(key));
  }
  return keys;
}

}  // namespace

void require_key(const std::string& text, const std::string& what) {
  if (!is_key(text)) {
    throw Error(
        fmt::format("{} '{}' is not a key: expected {} hexadecimal digits", what, printable(text, 100), key_digits));
  }
}

KeyPair make_key_pair() {
  std::array<char, z85_room> public_key{}, secret_key{};
  if (zmq_curve_keypair(public_key.data(), secret_key.data()) != 0) {
    throw Error(fmt::format("cannot make keys: {}", zmq_strerror(zmq_errno())));
  }
  return {hex_of_z85(public_key.data()), hex_of_z85(secret_key.data())};
}

fs::path keys_folder() {
  const auto set = [](const char* name) {
    const char* const value = std::getenv(name);
    return std::string(value == nullptr ? "" : value);
  };
  if (const auto folder = set("SPLATBUS_KEYS"); !folder.empty()) return folder;
  if (const auto folder = set("XDG_CONFIG_HOME"); !folder.empty()) return fs::path(folder) / "splatbus" / "keys";
  const auto home = set("HOME");
  if (home.empty()) throw Error("no folder for keys: set SPLATBUS_KEYS");
  return fs::path(home) / ".config" / "splatbus" / "keys";
}

void write_key_file(const fs::path& file, const KeyPair& keys) {
  make_folder(file.parent_path());
  write_private(file, fmt::format("public = {}\nsecret = {}\n", keys.public_key, keys.secret_key));
}

KeyPair read_key_file(const fs::path& file) {
  struct stat status {};
  std::istringstream words(read_private(file, status));
  KeyPair keys;
  std::string name, equals, value;
  while (words >> name >> equals >> value) {
    if (name == "public") keys.public_key = value;
    if (name == "secret") keys.secret_key = value;
  }
  std::array<char, z85_room> derived{};
  if (!is_key(keys.public_key) || !is_key(keys.secret_key) ||
      zmq_curve_public(derived.data(), z85_of_hex(keys.secret_key).c_str()) != 0 ||
      hex_of_z85(derived.data()) != keys.public_key) {
    refuse(file, "it does not hold a pair of keys");
  }
  return keys;
}

std::vector<AllowedKey> read_allow_list(const fs::path& file) {
  std::error_code ignored;
  if (!fs::exists(fs::symlink_status(file, ignored))) return {};
  struct stat status {};
  return parse_allow_list(file, read_private(file, status));
}

void write_allow_list(const fs::path& file, const std::vector<AllowedKey>& keys) {
  std::string text =
      "# Who may connect over a network, and as what: NAME PUBLICKEY ROLES (view, steer, probe, control)\n";
  for (const auto& key : keys) {
    if (!is_name(key.name)) throw Error(fmt::format("'{}' is not a valid name for a key", printable(key.name)));
    require_key(key.public_key, key.name);
    if (!key.rights.any()) throw Error(fmt::format("'{}' is allowed nothing", key.name));
    text += fmt::format("{} {} {}\n", key.name, key.public_key, to_text(key.rights));
  }
  make_folder(file.parent_path());
  fs::path next = file;
  next += fmt::format(".{}", ::getpid());
  std::error_code error;
  fs::remove(next, error);
  write_private(next, text);
  fs::rename(next, file, error);
  if (error) refuse(file, error.message());
}

AllowList::AllowList(fs::path file) : file_(std::move(file)) {
  const std::scoped_lock lock(mutex_);
  refresh();
}

Rights AllowList::rights_of(const Key& public_key) {
  const std::scoped_lock lock(mutex_);
  if (now_ns() - checked_ns_ >= check_every_ns) refresh();
  return find(public_key);
}

Rights AllowList::rights_now(const Key& public_key) {
  const std::scoped_lock lock(mutex_);
  refresh();
  return find(public_key);
}

Rights AllowList::find(const Key& public_key) const {
  const auto found = rights_.find(public_key);
  return found == rights_.end() ? Rights() : found->second;
}

void AllowList::refresh() {
  checked_ns_ = now_ns();
  struct stat status {};
  std::string stamp = "none";
  if (::lstat(file_.c_str(), &status) == 0) {
    stamp = fmt::format("{} {} {} {}.{} {}.{}", status.st_dev, status.st_ino, status.st_size, status.st_mtim.tv_sec,
                        status.st_mtim.tv_nsec, status.st_ctim.tv_sec, status.st_ctim.tv_nsec);
  }
  if (stamp == stamp_) return;
  stamp_ = stamp;
  rights_.clear();
  try {
    for (const auto& key : read_allow_list(file_)) rights_[key.public_key] = key.rights;
    spdlog::info("{}: {} keys are allowed", file_.string(), rights_.size());
  } catch (const Error& error) {
    spdlog::error("nobody is let in: {}", error.what());
  }
}

}  // namespace splatbus::bus
