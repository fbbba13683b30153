#include "splats/ply_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <limits>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string_view>

namespace splatbus::splats {
namespace {

constexpr std::size_t kMaxHeaderBytes = std::size_t{64} << 10;
constexpr std::size_t kMaxProperties = 1024;

struct Element {
  std::string name;
  std::size_t count = 0;
  std::size_t bytes = 0;  // of one row; unknown when has_list
  bool has_list = false;
};

std::optional<PlyType> type_named(std::string_view name) {
  struct Named {
    std::string_view name;
    PlyType type;
  };
  constexpr std::array<Named, 16> kTypes = {{{"char", PlyType::Int8},
                                             {"int8", PlyType::Int8},
                                             {"uchar", PlyType::UInt8},
                                             {"uint8", PlyType::UInt8},
                                             {"short", PlyType::Int16},
                                             {"int16", PlyType::Int16},
                                             {"ushort", PlyType::UInt16},
                                             {"uint16", PlyType::UInt16},
                                             {"int", PlyType::Int32},
                                             {"int32", PlyType::Int32},
                                             {"uint", PlyType::UInt32},
                                             {"uint32", PlyType::UInt32},
                                             {"float", PlyType::Float32},
                                             {"float32", PlyType::Float32},
                                             {"double", PlyType::Float64},
                                             {"float64", PlyType::Float64}}};
  const auto* found = std::find_if(kTypes.begin(), kTypes.end(), [name](const Named& t) { return t.name == name; });
  if (found == kTypes.end()) return std::nullopt;
  return found->type;
}

/// Reads line by line and knows where it is, for the messages.
class HeaderLines {
 public:
  HeaderLines(std::istream& stream, const std::string& path) : stream_(stream), path_(path) {}

  /// The words of the next line.
  std::vector<std::string> next() {
    ++line_;
    std::string text;
    char c = 0;
    while (stream_.get(c) && c != '\n') {
      text.push_back(c);
      if (++bytes_ > kMaxHeaderBytes) fail(fmt::format("no end_header in the first {} bytes", kMaxHeaderBytes));
    }
    if (!stream_) fail("the file ends inside the header");
    ++bytes_;
    if (!text.empty() && text.back() == '\r') text.pop_back();
    std::istringstream words(text);
    std::vector<std::string> out;
    for (std::string word; words >> word;) out.push_back(word);
    return out;
  }

  [[noreturn]] void fail(const std::string& what) const {
    throw std::runtime_error(fmt::format("{}: line {}: {}", path_, line_, what));
  }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  std::istream& stream_;
  const std::string& path_;
  std::size_t line_ = 0, bytes_ = 0;
};

std::size_t parse_count(const HeaderLines& lines, const std::string& word) {
  std::size_t count = 0;
  const char* end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(word.data(), end, count);
  if (error != std::errc() || stop != end) lines.fail(fmt::format("\"{:.40}\" is not a number of rows", word));
  return count;
}

void check_format(const HeaderLines& lines, const std::vector<std::string>& words) {
  if (words.size() != 3) lines.fail("expected \"format binary_little_endian 1.0\"");
  if (words[1] == "ascii" || words[1] == "binary_big_endian") {
    lines.fail(fmt::format("format {} is not supported; only binary_little_endian is", words[1]));
  }
  if (words[1] != "binary_little_endian" || words[2] != "1.0") {
    lines.fail(fmt::format("unknown format \"{:.40} {:.40}\"", words[1], words[2]));
  }
}

void add_property(const HeaderLines& lines, const std::vector<std::string>& words, std::vector<Element>& elements,
                  PlyHeader& header) {
  if (elements.empty()) lines.fail("a property before any element");
  Element& element = elements.back();
  if (words.size() == 5 && words[1] == "list") {
    if (element.name == "vertex") lines.fail("list properties of the element vertex are not supported");
    element.has_list = true;
    return;
  }
  if (words.size() != 3) lines.fail("expected \"property TYPE NAME\"");
  const std::optional<PlyType> type = type_named(words[1]);
  if (!type) lines.fail(fmt::format("unknown type \"{:.40}\"", words[1]));
  if (element.name == "vertex") {
    if (header.properties.size() == kMaxProperties) lines.fail(fmt::format("more than {} properties", kMaxProperties));
    if (header.find(words[2]) != nullptr) lines.fail(fmt::format("property \"{:.40}\" appears twice", words[2]));
    header.properties.push_back({words[2], *type, element.bytes});
  }
  element.bytes += size_of(*type);
}

/// The last one decides.
void take_comment(const std::vector<std::string>& words, PlyHeader& header) {
  const auto lower = [](std::string text) {
    std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
    return text;
  };
  if (words.size() != 3) return;
  const std::string key = lower(words[1]), value = lower(words[2]);
  if (key == "splatrendermode:") header.mip = value == "mip";
  if (key == "antialiased") header.mip = value == "1";
  if (key == "splataxes:") header.y_up = value == "y-up";
}

/// Finds the rows of `vertex` behind the header and checks that the file holds them.
void locate_rows(const HeaderLines& lines, const std::vector<Element>& elements, std::size_t file_bytes,
                 PlyHeader& header) {
  std::size_t offset = lines.bytes();
  for (const Element& element : elements) {
    const std::size_t left = file_bytes - std::min(file_bytes, offset);
    if (element.has_list) {
      lines.fail(
          fmt::format("element {:.40} comes before vertex and has a list property: not supported", element.name));
    }
    if (element.bytes > 0 && element.count > left / element.bytes) {
      lines.fail(fmt::format("{} rows of {} bytes are announced for element {:.40}, but only {} bytes follow",
                             element.count, element.bytes, element.name, left));
    }
    if (element.name == "vertex") {
      header.vertex_count = element.count;
      header.vertex_bytes = element.bytes;
      header.vertex_offset = offset;
      return;
    }
    offset += element.count * element.bytes;
  }
  lines.fail("there is no element vertex");
}

}  // namespace

std::size_t size_of(PlyType type) {
  switch (type) {
    case PlyType::Int8:
    case PlyType::UInt8:
      return 1;
    case PlyType::Int16:
    case PlyType::UInt16:
      return 2;
    case PlyType::Int32:
    case PlyType::UInt32:
    case PlyType::Float32:
      return 4;
    case PlyType::Float64:
      return 8;
  }
  return 0;
}

const PlyProperty* PlyHeader::find(const std::string& name) const {
  const auto found =
      std::find_if(properties.begin(), properties.end(), [&name](const PlyProperty& p) { return p.name == name; });
  return found == properties.end() ? nullptr : &*found;
}

PlyHeader read_ply_header(std::istream& stream, const std::string& path, std::size_t file_bytes) {
  HeaderLines lines(stream, path);
  if (lines.next() != std::vector<std::string>{"ply"})
    lines.fail("this is not a PLY file: it does not begin with \"ply\"");
  PlyHeader header;
  std::vector<Element> elements;
  bool has_format = false;
  for (;;) {
    const std::vector<std::string> words = lines.next();
    if (words.empty() || words[0] == "obj_info") continue;
    if (words[0] == "comment") {
      take_comment(words, header);
      continue;
    }
    if (words[0] == "end_header") break;
    if (words[0] == "format") {
      check_format(lines, words);
      has_format = true;
    } else if (words[0] == "element") {
      if (words.size() != 3) lines.fail("expected \"element NAME COUNT\"");
      const auto same = [&words](const Element& e) { return e.name == words[1]; };
      if (std::any_of(elements.begin(), elements.end(), same))
        lines.fail(fmt::format("second element {:.40}", words[1]));
      elements.push_back({words[1], parse_count(lines, words[2]), 0, false});
    } else if (words[0] == "property") {
      add_property(lines, words, elements, header);
    } else {
      lines.fail(fmt::format("unknown keyword \"{:.40}\"", words[0]));
    }
  }
  if (!has_format) lines.fail("the header names no format");
  locate_rows(lines, elements, file_bytes, header);
  return header;
}

}  // namespace splatbus::splats
