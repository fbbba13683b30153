#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "bus/tensor_ring.h"
#include "host_model.h"
#include "synthetic_scene.h"
#include "trainer/trainer.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/system_generated.h"

namespace splatbus::trainer {

using namespace std::chrono_literals;

/// How long a condition that must come true may take: only there to end a test that hangs, also where every access of a
/// kernel is checked.
constexpr auto kPatience = 120s;

/// A trainer on a bus, with an expander, a capture bridge and a relight made by hand.
class TrainerTest : public bus_test::BusTest {
 protected:
  TrainerTest()
      : peer_(connect("peer")),
        subscriber_(peer_, {"model/published", "trainer/stats", "sys/heartbeat"}),
        publisher_(peer_),
        ring_(std::make_unique<bus::TensorRing>(peer_, "pictures", 32)) {
    set("threads", "1", false);
    set("input_view_interval", "0", false);
    set("pair_visibility", "false", false);  // there is no relight
  }

  ~TrainerTest() override { stop(); }

  /// Before start(): where the trainer's model lies, and where the slabs of those that feed it.
  void place(Device trainer, Device producers) {
    backend_ = trainer;
    ring_ = std::make_unique<bus::TensorRing>(peer_, "pictures", 32, 0, producers);
  }

  void set(const std::string& name, const std::string& value, bool at_runtime = true) {
    EXPECT_EQ(parameters_.set(name, value, at_runtime), "");
  }

  /// With steps that `make` makes, where given. Whatever ends the trainer is kept in `ended_with_`.
  void start(const StepMaker& make = make_gradient_step) {
    stop_ = std::stop_source();
    service_ = std::make_unique<bus::ServiceContext>(connect("trainer"), parameters_, stop_.get_token(), backend_);
    ended_with_ = nullptr;
    thread_ = std::thread([this, make] {
      try {
        Trainer(*service_, make).run();
      } catch (...) {
        ended_with_ = std::current_exception();
      }
    });
    ASSERT_TRUE(until([&] { return published(); }));
  }

  /// Waits for a trainer that ends by itself.
  void join() {
    if (thread_.joinable()) thread_.join();
  }

  void stop() {
    stop_.request_stop();
    join();
    service_.reset();
    newest_.clear();
  }

  /// Receives until the condition holds.
  bool until(const std::function<bool()>& condition) {
    return bus_test::eventually(
        [&] {
          while (auto message = subscriber_.receive(5ms)) newest_.insert_or_assign(message->topic(), *message);
          return condition();
        },
        kPatience);
  }

  const wire::ModelPublished* published() {
    const auto found = newest_.find("model/published");
    return found == newest_.end() ? nullptr : &found->second.root<wire::ModelPublished>();
  }
  const wire::TrainerStats* stats() {
    const auto found = newest_.find("trainer/stats");
    return found == newest_.end() ? nullptr : &found->second.root<wire::TrainerStats>();
  }
  /// Of the trainer's newest heartbeat.
  std::optional<double> counter(const std::string& name) {
    const auto found = newest_.find("sys/heartbeat");
    if (found == newest_.end()) return {};
    const auto* const counters = found->second.root<wire::Heartbeat>().counters();
    for (const wire::Counter* one : *counters) {
      if (one->name()->str() == name) return one->value();
    }
    return {};
  }
  bool holds(std::uint64_t batch) {
    const auto* model = published();
    if (model == nullptr || model->insert_epoch() != peer_->epoch()) return false;
    const auto* batches = model->inserted_batches();
    return std::find(batches->begin(), batches->end(), batch) != batches->end();
  }

  /// What the newest model/published names, as it is now.
  std::optional<HostModel> read_model() {
    const bus::Message& message = newest_.at("model/published");
    const auto& model = *published();
    const ParameterLayout layout{};
    const std::uint32_t capacity = model.page_capacity();
    const auto table = message.tensor("page_table", bus::ElementType::U8,
                                      {static_cast<std::uint32_t>(model::page_table_bytes(capacity))});
    if (!table) return std::nullopt;
    const auto* const entries = model::page_entries(*reinterpret_cast<const model::PageTableHeader*>(table->data()));
    std::vector<IndexRange> ranges;
    for (std::uint32_t page = 0; page < capacity; ++page) {
      const model::PageStructure& now = entries[page].now;
      if (model::is_present(now.state)) ranges.push_back({page * kPageLanes, now.count, now.frame_id});
    }
    std::vector<std::uint32_t> words;
    for (int arena = 0; message.announces("pages-" + std::to_string(arena)); ++arena) {
      const auto pages =
          message.tensor("pages-" + std::to_string(arena), bus::ElementType::U32, {0, model::page_words(layout)});
      if (!pages) return std::nullopt;
      words.resize(words.size() + pages->elements());
      if (!pages->copy(words.data() + words.size() - pages->elements())) return std::nullopt;
    }
    // It may have grown since it was told of.
    if (!ranges.empty() && (ranges.back().first >> kPageShift) >= words.size() / model::page_words(layout)) {
      return std::nullopt;
    }
    return HostModel(layout, ranges, std::move(words));
  }

  void publish_insert(const SampleBatch& batch, const std::string& without = {}) {
    std::vector<bus::TensorSource> sources = batch.tensors();
    std::erase_if(sources, [&](const bus::TensorSource& source) { return source.name == without; });
    publisher_.publish(topics::kModelInsert, {.tensors = ring_->write(sources)}, [&](auto& builder, auto header) {
      const auto light = to_wire(builder, batch.scene.light);
      return wire::CreateModelInsert(builder, header, batch.batch, 0, light);
    });
  }

  void insert(const SampleBatch& batch) {
    ASSERT_TRUE(until([&] {
      publish_insert(batch);  // as the expander does, until it is acknowledged
      return holds(batch.batch);
    }));
  }

  /// `object_id`: where there is one, a picture of who shows where.
  void publish_view(const TrainingView& view, bool retire = false, std::uint32_t height_off = 0,
                    const std::vector<std::uint32_t>& object_id = {}) {
    const std::uint32_t h = view.camera.height + height_off;
    const std::uint32_t w = view.camera.width;
    std::vector<bus::TensorSource> sources;
    if (!retire && height_off == 0) {
      sources = {{.name = "color", .shape = {h, w, 4}, .type = bus::ElementType::U8, .data = view.color.data()},
                 {.name = "albedo", .shape = {h, w, 4}, .type = bus::ElementType::U8, .data = view.albedo.data()},
                 {.name = "depth", .shape = {h, w}, .type = bus::ElementType::F32, .data = view.depth.data()}};
    } else if (!retire) {
      sources = {{.name = "color",
                  .shape = {h - 2 * height_off, w, 4},
                  .type = bus::ElementType::U8,
                  .data = view.color.data()}};
    }
    if (!object_id.empty()) {
      sources.push_back(
          {.name = "object_id", .shape = {h, w}, .type = bus::ElementType::U32, .data = object_id.data()});
    }
    bus::MessageInfo info;
    if (!sources.empty()) info.tensors = ring_->write(sources);
    publisher_.publish(topics::kCaptureReference, info, [&](auto& builder, auto header) {
      const auto scene = to_wire(builder, view.scene, view.frame);
      const auto camera = to_wire(view.camera);
      return wire::CreateCaptureReference(builder, header, &camera, scene, retire);
    });
  }

  /// `values` for each light in turn.
  void publish_visibility(const std::vector<std::uint8_t>& values, std::uint64_t generation,
                          std::uint64_t scene_version = 1, const std::vector<std::uint32_t>& light_ids = {0}) {
    const auto rows = static_cast<std::uint32_t>(std::max<std::size_t>(1, light_ids.size()));
    const auto n = static_cast<std::uint32_t>(values.size()) / rows;
    const bus::TensorSource source{
        .name = "visibility", .shape = {rows, n}, .type = bus::ElementType::U8, .data = values.data()};
    publisher_.publish(topics::kRelightVisibility, {.tensors = ring_->write({&source, 1})},
                       [&](auto& builder, auto header) {
                         return wire::CreateRelightVisibility(builder, header, generation, scene_version, n,
                                                              builder.CreateVector(light_ids));
                       });
  }

  void show(const SyntheticScene& scene) {
    ASSERT_TRUE(until([&] {
      for (const auto& view : scene.views()) publish_view(*view);
      return stats() != nullptr && stats()->ready_references() == scene.views().size();
    }));
  }

  bus::Parameters parameters_{bus::Parameters::declare<Options>()};
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  std::unique_ptr<bus::TensorRing> ring_;
  Device backend_ = Device::Cpu;
  std::stop_source stop_;
  std::unique_ptr<bus::ServiceContext> service_;
  std::thread thread_;
  std::exception_ptr ended_with_;  // after join()
  std::map<std::string, bus::Message> newest_;
};

}  // namespace splatbus::trainer
