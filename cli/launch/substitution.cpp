#include "substitution.h"

#include <cstddef>
#include <stdexcept>

namespace splatbus::cli {

namespace {

constexpr std::size_t kMaxLength = 1 << 16;  // names of names of names grow without end

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  for (std::size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
  return text;
}

}  // namespace

const std::vector<std::string>& process_variables() {
  static const std::vector<std::string> names{"bus_dir", "name", "replica"};
  return names;
}

std::string substitute(const std::string& text, const Lookup& lookup) {
  std::string result;
  std::size_t at = 0;
  while (at < text.size()) {
    if (text.compare(at, 3, "$${") == 0) {
      result += "$${";
      at += 3;
    } else if (text.compare(at, 2, "${") == 0) {
      const std::size_t end = text.find('}', at);
      if (end == std::string::npos)
        throw std::invalid_argument("'${' has no '}'; write '$${' for the characters themselves");
      const auto value = lookup(text.substr(at + 2, end - at - 2));
      result += value ? *value : text.substr(at, end + 1 - at);
      if (result.size() > kMaxLength) throw std::invalid_argument("a text of more than 64 KiB");
      at = end + 1;
    } else {
      result += text[at++];
    }
  }
  return result;
}

std::string escaped(const std::string& text) {
  return replaced(text, "${", "$${");
}

std::string unescaped(const std::string& text) {
  return replaced(text, "$${", "${");
}

}  // namespace splatbus::cli
