#pragma once

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "sample_batch.h"
#include "trainer/model_store.h"
#include "wire/model_generated.h"
#include "wire/published_model.h"

namespace splatbus::trainer {

constexpr std::uint64_t kEpoch = 10;

/// A store on a bus of its own, and a reader of what it publishes.
class ModelStoreTest : public bus_test::BusTest {
 protected:
  ModelStoreTest() : reader_(connect("reader")), subscriber_(reader_, {"model/published"}) { restart(); }

  void SetUp() override { ASSERT_TRUE(subscriber_.wait_connected(std::chrono::seconds(20))); }

  /// A trainer process that begins: the one before was killed.
  void restart(std::size_t capacity = 64, const ParameterLayout& layout = {}, std::size_t max_gaussians = 1000) {
    publisher_.reset();
    store_.reset();
    context_ = connect("trainer");
    store_ = std::make_unique<ModelStore>(context_, layout, capacity, max_gaussians);
    publisher_ = std::make_unique<bus::Publisher>(context_);
  }

  void append(std::uint64_t batch, std::size_t count, std::uint64_t epoch = kEpoch) {
    store_->change([&] { store_->append(sample_batch(epoch, batch, count, static_cast<unsigned>(batch))); });
  }

  void remove(const std::set<std::size_t>& columns) {
    std::vector<std::uint8_t> dead(store_->count(), 0);
    for (const std::size_t column : columns) dead[column] = 1;
    store_->change([&] { keep_ = kept_columns(store_->remove(dead.data())); });
  }

  std::optional<PublishedModel> publish_and_open() {
    store_->publish(*publisher_);
    const auto message = last_published();
    return message ? PublishedModel::open(*message) : std::nullopt;
  }

  std::optional<bus::Message> last_published() {
    const auto generation = store_->structure().generation;
    std::optional<bus::Message> newest;
    bus_test::eventually([&] {
      if (auto message = subscriber_.receive(std::chrono::milliseconds(20))) newest = std::move(message);
      return newest && newest->root<wire::ModelPublished>().generation() == generation &&
             newest->header().epoch() == context_->epoch();
    });
    return newest;
  }

  bool set_visibility(std::uint64_t generation, const std::vector<float>& values) {
    return store_->set_visibility(generation, values.data(), Device::Cpu, values.size());
  }

  /// What the present trainer's header slab holds, for damage.
  SlabHeader& header() {
    header_ = context_->adopt_slab("trainer/model-header");
    return *reinterpret_cast<SlabHeader*>(header_->slot_data(0));
  }
  Structure& current_structure() {
    SlabHeader& of = header();
    return of.structure.at(of.current);
  }

  /// First mean coordinate of every Gaussian by id.
  static std::map<std::uint64_t, float> by_id(const GaussiansView& view) {
    std::map<std::uint64_t, float> result;
    for (std::size_t i = 0; i < view.count; ++i) result[view.gaussian_id[i]] = view.parameters[i];
    return result;
  }

  std::shared_ptr<bus::Context> reader_, context_;
  std::shared_ptr<bus::Slab> header_;
  bus::Subscriber subscriber_;
  std::unique_ptr<ModelStore> store_;
  std::unique_ptr<bus::Publisher> publisher_;
  std::vector<std::uint32_t> keep_;
};

}  // namespace splatbus::trainer
