#pragma once

#include <flatbuffers/idl.h>

#include <string>
#include <vector>

namespace splatbus::golden {

/// A message of a root table with every field set, each to a value of its own, as JSON for the schema's parser.
struct Example {
  std::string name;  ///< "EngineFrame", or "Packet.Hello" for one member of a union
  std::string root;  ///< "EngineFrame"
  std::string json;
};

/// One for every table whose first field is the Header, and for every member of the union that such a table holds.
std::vector<Example> make_examples(const flatbuffers::Parser& schema);

}  // namespace splatbus::golden
