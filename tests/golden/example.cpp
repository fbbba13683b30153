#include "example.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>

namespace splatbus::golden {
namespace {

using flatbuffers::EnumDef;
using flatbuffers::FieldDef;
using flatbuffers::StructDef;
using flatbuffers::Type;

constexpr int vector_length = 2;

// Of those that are no longer at their first.
int version_of(const std::string& root) {
  static const std::map<std::string, int> changed{
      {"CaptureInput", 3},    {"CaptureProbe", 3}, {"CaptureReference", 3}, {"EngineFrame", 3},
      {"SceneLightDepth", 3}, {"TrainerStats", 2}, {"RelightVisibility", 2}};
  const auto found = changed.find(root);
  return found == changed.end() ? 1 : found->second;
}

/// Writes values that differ from field to field, and from every default.
class Filler {
 public:
  Filler(const StructDef& root, const flatbuffers::EnumVal* union_member) : root_(root), member_(union_member) {}

  std::string table(const StructDef& definition) {
    std::vector<std::string> fields;
    for (const FieldDef* field : definition.fields.vec) {
      if (field->deprecated || field->value.type.base_type == flatbuffers::BASE_TYPE_UTYPE) continue;
      if (field->value.type.base_type == flatbuffers::BASE_TYPE_UNION) {
        fields.push_back(fmt::format("\"{}_type\": \"{}\"", field->name, member_->name));
        fields.push_back(fmt::format("\"{}\": {}", field->name, table(*member_->union_type.struct_def)));
        continue;
      }
      fields.push_back(fmt::format("\"{}\": {}", field->name, value(*field, field->value.type)));
    }
    return fmt::format("{{{}}}", fmt::join(fields, ", "));
  }

 private:
  std::string value(const FieldDef& field, const Type& type) {
    switch (type.base_type) {
      case flatbuffers::BASE_TYPE_STRUCT:
        return table(*type.struct_def);
      case flatbuffers::BASE_TYPE_STRING:
        return field.name == "schema" ? fmt::format("\"{}/{}\"", root_.name, version_of(root_.name))
                                      : fmt::format("\"{} {}\"", field.name, ++next_);
      case flatbuffers::BASE_TYPE_VECTOR:
        return elements(field, type.VectorType(), vector_length);
      case flatbuffers::BASE_TYPE_ARRAY:
        return elements(field, type.VectorType(), type.fixed_length);
      default:
        return scalar(type);
    }
  }

  std::string elements(const FieldDef& field, const Type& type, int count) {
    std::vector<std::string> result;
    result.reserve(static_cast<std::size_t>(count));
    for (int i = 0; i < count; ++i) result.push_back(value(field, type));
    return fmt::format("[{}]", fmt::join(result, ", "));
  }

  std::string scalar(const Type& type) {
    ++next_;
    if (type.enum_def != nullptr) {
      const auto& values = type.enum_def->Vals();
      return fmt::format("\"{}\"", values.back()->name);
    }
    switch (type.base_type) {
      case flatbuffers::BASE_TYPE_BOOL:
        return "true";
      case flatbuffers::BASE_TYPE_CHAR:
      case flatbuffers::BASE_TYPE_UCHAR:
        return fmt::format("{}", next_ % 100 + 1);
      case flatbuffers::BASE_TYPE_SHORT:
      case flatbuffers::BASE_TYPE_USHORT:
        return fmt::format("{}", next_ + 1000);
      case flatbuffers::BASE_TYPE_INT:
      case flatbuffers::BASE_TYPE_UINT:
        return fmt::format("{}", next_ + 1'000'000);
      case flatbuffers::BASE_TYPE_LONG:
      case flatbuffers::BASE_TYPE_ULONG:
        return fmt::format("{}", next_ + 1'000'000'000'000);
      case flatbuffers::BASE_TYPE_FLOAT:
      case flatbuffers::BASE_TYPE_DOUBLE:
        return fmt::format("{}.25", next_);
      default:
        throw std::logic_error("a scalar of a kind that no schema uses");
    }
  }

  const StructDef& root_;
  const flatbuffers::EnumVal* member_;
  std::int64_t next_ = 0;
};

bool is_root(const StructDef& definition) {
  if (definition.fixed || definition.fields.vec.empty()) return false;
  const FieldDef& first = *definition.fields.vec.front();
  return first.name == "header" && first.value.type.struct_def != nullptr &&
         first.value.type.struct_def->name == "Header";
}

const EnumDef* union_of(const StructDef& definition) {
  for (const FieldDef* field : definition.fields.vec) {
    if (field->value.type.base_type == flatbuffers::BASE_TYPE_UNION) return field->value.type.enum_def;
  }
  return nullptr;
}

}  // namespace

std::vector<Example> make_examples(const flatbuffers::Parser& schema) {
  std::vector<Example> result;
  for (const StructDef* definition : schema.structs_.vec) {
    if (!is_root(*definition)) continue;
    const EnumDef* choices = union_of(*definition);
    if (choices == nullptr) {
      result.push_back({definition->name, definition->name, Filler(*definition, nullptr).table(*definition)});
      continue;
    }
    for (const auto* member : choices->Vals()) {
      if (member->union_type.struct_def == nullptr) continue;  // NONE
      result.push_back({fmt::format("{}.{}", definition->name, member->name), definition->name,
                        Filler(*definition, member).table(*definition)});
    }
  }
  return result;
}

}  // namespace splatbus::golden
