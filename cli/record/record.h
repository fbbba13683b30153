#pragma once

#include "verbs.h"

namespace splatbus::cli {

/// `record info`, below the verb `record`.
void add_record_info_verb(CLI::App& record, Action& action);

}  // namespace splatbus::cli
