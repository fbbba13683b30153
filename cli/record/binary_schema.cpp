#include <flatbuffers/idl.h>
#include <fmt/format.h>

#include <set>
#include <sstream>

#include "recording_file.h"
#include "schema_json.h"

namespace splatbus::cli {

namespace {

/// The schema's text behind that of what it includes, each once, without the lines that name files.
std::string with_includes(const std::string& name, std::set<std::string>& seen) {
  if (!seen.insert(name).second) return {};
  std::string before, own, line;
  for (const EmbeddedSchema& schema : embedded_schemas()) {
    if (schema.name != name) continue;
    std::istringstream lines(schema.text);
    while (std::getline(lines, line)) {
      if (!line.starts_with("include ")) {
        own += line + "\n";
        continue;
      }
      const auto begin = line.find('"') + 1;
      before += with_includes(line.substr(begin, line.rfind('"') - begin), seen);
    }
  }
  return before + own;
}

}  // namespace

std::vector<std::byte> binary_schema(const std::string& table) {
  for (const EmbeddedSchema& schema : embedded_schemas()) {
    std::set<std::string> seen;
    flatbuffers::Parser parser;
    if (!parser.Parse(with_includes(schema.name, seen).c_str(), nullptr, schema.name)) {
      throw bus::Error(fmt::format("embedded schema {}: {}", schema.name, parser.error_));
    }
    if (!parser.SetRootType(table.c_str())) continue;
    parser.Serialize();
    const auto* bytes = reinterpret_cast<const std::byte*>(parser.builder_.GetBufferPointer());
    return {bytes, bytes + parser.builder_.GetSize()};
  }
  return {};
}

}  // namespace splatbus::cli
