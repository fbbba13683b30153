#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "gateway/bench_log.h"
#include "gateway/pipeline_view.h"
#include "gateway/traffic.h"

namespace splatbus::gateway {

/// Prometheus' text format, version 0.0.4.
[[nodiscard]] std::string metrics_text(const PipelineView& pipeline, const Traffic& traffic, std::int64_t now_ns);

/// The same and more, for people and scripts; docs/gateway.md describes it.
[[nodiscard]] nlohmann::json status_json(const PipelineView& pipeline, const Traffic& traffic, const BenchLog& bench,
                                         std::int64_t now_ns);

}  // namespace splatbus::gateway
