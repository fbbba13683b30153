#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>

namespace splatbus::fuzz {

/// One to four changes of the kinds that readers trip over. Half of them fall into the first `header_bytes`, where
/// there are any.
inline std::string mutate(std::string bytes, std::mt19937_64& random, std::size_t header_bytes = 0) {
  const std::size_t changes = 1 + random() % 4;
  for (std::size_t i = 0; i < changes && !bytes.empty(); ++i) {
    const bool in_header = header_bytes > 0 && random() % 2 == 0;
    const std::size_t at = random() % (in_header ? std::min(bytes.size(), header_bytes) : bytes.size());
    switch (random() % 6) {
      case 0:
        bytes[at] = static_cast<char>(random());
        break;
      case 1:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
        break;
      case 2:
        bytes.resize(at);
        break;
      case 3:
        bytes.insert(at, random() % 64, static_cast<char>(random()));
        break;
      case 4: {  // an offset or a length of interest
        constexpr std::array<std::uint32_t, 6> values{0, 1, 0x7fffffff, 0x80000000, 0xffffffff, 0xfffffff0};
        const std::uint32_t value = values[random() % values.size()];
        if (at + sizeof(value) <= bytes.size()) std::memcpy(bytes.data() + at, &value, sizeof(value));
        break;
      }
      default: {
        const std::size_t from = random() % bytes.size();
        const std::size_t length = std::min({random() % 32, bytes.size() - at, bytes.size() - from});
        std::memmove(bytes.data() + at, bytes.data() + from, length);
      }
    }
  }
  return bytes;
}

}  // namespace splatbus::fuzz
