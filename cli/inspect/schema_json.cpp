#include "schema_json.h"

#include <flatbuffers/idl.h>
#include <flatbuffers/reflection.h>
#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "wire/schemas.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

flatbuffers::IDLOptions json_options() {
  flatbuffers::IDLOptions options;
  options.strict_json = true;
  options.indent_step = -1;
  options.output_default_scalars_in_json = true;
  options.allow_non_utf8 = true;
  return options;
}

/// FlatBuffers prints nan and inf, which JSON does not have.
std::string without_non_finite(const std::string& text) {
  std::string result;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size();) {
    const char c = text[i];
    if (in_string || std::isalpha(static_cast<unsigned char>(c)) == 0) {
      if (in_string && c == '\\' && i + 1 < text.size()) result += text[i++];
      if (text[i] == '"' && c == '"') in_string = !in_string;
      result += text[i++];
      continue;
    }
    std::size_t end = i;
    while (end < text.size() && std::isalpha(static_cast<unsigned char>(text[end])) != 0) ++end;
    const std::string word = text.substr(i, end - i);
    if (word == "nan" || word == "inf") {
      if (!result.empty() && result.back() == '-') result.pop_back();
      result += "null";
    } else {
      result += word;
    }
    i = end;
  }
  return result;
}

float half_to_float(std::uint16_t half) {
  const int exponent = (half >> 10) & 31;
  const auto mantissa = static_cast<float>(half & 1023);
  const float sign = (half & 0x8000) != 0 ? -1.0F : 1.0F;
  if (exponent == 31) return mantissa != 0 ? NAN : sign * INFINITY;
  return sign * (exponent == 0 ? std::ldexp(mantissa, -24) : std::ldexp(mantissa + 1024, exponent - 25));
}

template <class T>
void add_range(Json& summary, const std::vector<std::byte>& bytes) {
  const auto* values = reinterpret_cast<const T*>(bytes.data());
  const std::size_t count = bytes.size() / sizeof(T);
  if (count == 0) return;
  // NaN compares false, so that min and max pass over it.
  const auto [least, most] = std::minmax_element(values, values + count);
  summary["min"] = *least;
  summary["max"] = *most;
}

Json tensor_summary(const bus::Message& message, const wire::Tensor& tensor) {
  Json summary{{"name", tensor.name()->str()},
               {"shape", std::vector<std::uint32_t>(tensor.shape()->begin(), tensor.shape()->end())},
               {"type", wire::EnumNameElementType(tensor.type())},
               {"min", nullptr},
               {"max", nullptr}};
  std::vector<std::byte> bytes;
  std::optional<bus::TensorView> view;
  try {
    view = message.tensor(tensor.name()->str());
    if (!view) return summary;
    bytes.resize(view->bytes());
    if (!view->copy(bytes.data())) return summary;
  } catch (const bus::Error& error) {
    // Memory of a device that this machine or build does not have; the rest of the message is worth showing.
    summary["unreadable"] = error.what();
    return summary;
  }
  switch (view->type()) {
    case wire::ElementType::U8:
      add_range<std::uint8_t>(summary, bytes);
      break;
    case wire::ElementType::U16:
      add_range<std::uint16_t>(summary, bytes);
      break;
    case wire::ElementType::U32:
      add_range<std::uint32_t>(summary, bytes);
      break;
    case wire::ElementType::U64:
      add_range<std::uint64_t>(summary, bytes);
      break;
    case wire::ElementType::I32:
      add_range<std::int32_t>(summary, bytes);
      break;
    case wire::ElementType::F32:
      add_range<float>(summary, bytes);
      break;
    case wire::ElementType::F16: {
      std::vector<std::byte> wide(bytes.size() * 2);
      for (std::size_t i = 0; i < bytes.size() / 2; ++i) {
        reinterpret_cast<float*>(wide.data())[i] =
            half_to_float(reinterpret_cast<const std::uint16_t*>(bytes.data())[i]);
      }
      add_range<float>(summary, wide);
      break;
    }
  }
  return summary;
}

}  // namespace

struct SchemaJson::Impl {
  /// Knows the tables of one of wire::find_schema's schemas. Throws bus::Error.
  flatbuffers::Parser& parser_of(const wire::TableSchema& schema) {
    auto& parser = parsers[schema.binary.data()];
    if (parser == nullptr) {
      parser = std::make_unique<flatbuffers::Parser>(json_options());
      if (!parser->Deserialize(schema.binary.data(), schema.binary.size())) {
        throw bus::Error(fmt::format("embedded schema of {}: {}", schema.table, parser->error_));
      }
    }
    return *parser;
  }

  std::map<const std::uint8_t*, std::unique_ptr<flatbuffers::Parser>> parsers;
};

SchemaJson::SchemaJson() : impl_(std::make_unique<Impl>()) {}

SchemaJson::~SchemaJson() = default;

Json SchemaJson::to_json(const bus::Message& message) {
  const std::string schema = message.header().schema()->str();
  const auto known = wire::find_schema(schema);
  if (!known) throw bus::Error(fmt::format("{}: unknown schema '{}'", message.topic(), schema));
  const std::string table(known->table);
  const auto& reflection = *reflection::GetSchema(known->binary.data());
  if (!flatbuffers::Verify(reflection, *reflection.objects()->LookupByKey(table.c_str()), message.bytes(),
                           message.size())) {
    throw bus::Error(fmt::format("{}: not a valid {}", message.topic(), schema));
  }
  flatbuffers::Parser& parser = impl_->parser_of(*known);
  parser.root_struct_def_ = parser.LookupStruct(table);
  std::string text;
  if (!flatbuffers::GenerateText(parser, message.bytes(), &text)) {
    throw bus::Error(fmt::format("{}: {} cannot be written as text", message.topic(), schema));
  }
  Json json = Json::parse(without_non_finite(text), nullptr, false);
  if (json.is_discarded()) throw bus::Error(fmt::format("{}: {} has text that is not UTF-8", message.topic(), schema));
  if (message.header().tensors() != nullptr) {
    Json& tensors = json["header"]["tensors"] = Json::array();
    for (const wire::Tensor* tensor : *message.header().tensors()) {
      tensors.push_back(tensor_summary(message, *tensor));
    }
  }
  return json;
}

}  // namespace splatbus::cli
