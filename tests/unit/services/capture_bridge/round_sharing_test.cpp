// Bridges that do not lead sample rounds of the one that does.
#include <cstring>

#include "sampled_views.h"
#include "sharing_fixture.h"
#include "wire/capture_generated.h"

namespace splatbus::capture_bridge::test {
namespace {

TEST_F(RoundSharingTest, ARoundComesToTheSameWhoeverSamplesIt) {
  meet_helper();
  const InputJob round = job();
  sharing_.hand(round, now_ns_);
  ASSERT_TRUE(until([&] { return !sampled_.empty(); }));
  EXPECT_EQ(sampled_.front().job.views, round.views);
  EXPECT_TRUE(sharing_.has_idle(now_ns_));

  bus::Subscriber reader(connect("reader"), {"capture/input"});
  ASSERT_TRUE(reader.wait_connected(bus_test::patience));
  InputWorker worker(lead_, Device::Cpu, kExpected);
  worker.publish(sampled_.front().job, sampled_.front().result);
  const auto message = reader.receive(bus_test::patience);
  ASSERT_TRUE(message);
  const auto& input = message->root<wire::CaptureInput>();
  EXPECT_EQ(input.header()->source()->str(), "capture-bridge-1");
  EXPECT_EQ(input.rig_generation(), 7U);
  EXPECT_EQ(input.cameras()->size(), static_cast<std::size_t>(kViews));
  EXPECT_EQ(input.scene()->frame(), static_cast<std::uint64_t>(kViews - 1));

  std::vector<InputView> views;
  for (const InputViewPointer& view : round.views) views.push_back(*view);
  const SampledRound here = sample(views, newest_of(round).objects, round.options);
  ASSERT_GT(here.samples.size(), 100U);
  const auto same = [&](const char* name, const auto& expected) {
    const auto tensor = message->tensor(name);
    ASSERT_TRUE(tensor) << name;
    ASSERT_EQ(tensor->bytes(), expected.size() * sizeof(expected[0])) << name;
    EXPECT_EQ(std::memcmp(tensor->data(), expected.data(), tensor->bytes()), 0) << name;
  };
  const SampleSet& samples = here.samples;
  same("position", samples.position);
  same("normal", samples.normal);
  same("albedo", samples.albedo);
  same("color", samples.color);
  same("spacing", samples.spacing_m);
  same("object_id", samples.object_id);
  EXPECT_EQ(worker.statistics().rounds, 1U);
  EXPECT_EQ(worker.statistics().samples, samples.size());
  EXPECT_EQ(worker.statistics().culled, here.culled);
  EXPECT_EQ(worker.statistics().thinned, here.thinned);
  EXPECT_EQ(worker.take_published().size(), 1U);
}

TEST_F(RoundSharingTest, WhoHasNotOfferedItselfOrDoesNotRunIsGivenNothing) {
  EXPECT_FALSE(bus_test::eventually(
      [&] {
        helper_.step(1ms);
        subscriber_.dispatch_all(1ms);
        return sharing_.has_idle(now_ns_);
      },
      1500ms))
      << "the broker has not named it";
  Node starts = bridge(*other_);
  starts.state = wire::ServiceState::Starting;
  helps_ = false;
  for (const Node& node : {bridge(*lead_), starts, Node{.name = "capture-bridge-2", .epoch = other_->epoch()}}) {
    hear({node});
    EXPECT_EQ(sharing_.helpers(), 0U);
  }
  hear_both();
  EXPECT_FALSE(sharing_.has_idle(now_ns_));
  helps_ = true;
  ASSERT_TRUE(until([&] { return sharing_.has_idle(now_ns_); }));
  // Nor is the one that leads, whatever it said before it did.
  hear({bridge(*lead_)});
  bus::Publisher(lead_).publish(topics::kSamplingOffer,
                                [](auto& builder, auto header) { return wire::CreateSamplingOffer(builder, header); });
  helps_ = false;
  EXPECT_FALSE(bus_test::eventually(
      [&] {
        subscriber_.dispatch_all(1ms);
        return sharing_.has_idle(now_ns_);
      },
      200ms));
  helps_ = true;
  meet_helper();
  // Another process of that name has not.
  Node again = bridge(*other_);
  ++again.epoch;
  hear({bridge(*lead_), again});
  EXPECT_FALSE(sharing_.has_idle(now_ns_));
}

TEST_F(RoundSharingTest, AllSampleAsManyPixels) {
  meet_helper();
  EXPECT_FALSE(sharing_.is_anothers_turn(now_ns_)) << "this bridge first";
  sharing_.keep(job(3));
  EXPECT_TRUE(sharing_.is_anothers_turn(now_ns_));
  sharing_.hand(job(2), now_ns_);
  EXPECT_FALSE(sharing_.is_anothers_turn(now_ns_)) << "it has one in hand";
  let_it_answer();
  EXPECT_TRUE(sharing_.is_anothers_turn(now_ns_));
  sharing_.keep_not(job(1));
  EXPECT_FALSE(sharing_.is_anothers_turn(now_ns_));
  sharing_.keep(job(4));
  Node again = bridge(*other_);
  ++again.epoch;
  hear({bridge(*lead_), again});
  hear_both();
  ASSERT_TRUE(until([&] { return sharing_.has_idle(now_ns_); }));
  EXPECT_FALSE(sharing_.is_anothers_turn(now_ns_)) << "who comes has nothing to catch up with";
}

TEST_F(RoundSharingTest, WhatAHelperHasInHandComesBackWhenItGoesAndItsAnswerCountsForNothing) {
  for (const bool same_name : {false, true}) {
    meet_helper();
    sharing_.hand(job(), now_ns_);
    EXPECT_FALSE(sharing_.has_idle(now_ns_));
    EXPECT_TRUE(sharing_.take_back(now_ns_).empty());
    Node again = bridge(*other_);
    ++again.epoch;
    same_name ? hear({bridge(*lead_), again}) : hear({bridge(*lead_)});
    EXPECT_EQ(sharing_.take_back(now_ns_).size(), 1U);
    EXPECT_TRUE(sharing_.take_back(now_ns_).empty());
    hear_both();
    let_it_answer();
    EXPECT_TRUE(sampled_.empty());
  }
  EXPECT_EQ(sharing_.handed(), 2U);
  EXPECT_EQ(sharing_.came_back(), 2U);
}

TEST_F(RoundSharingTest, WhoTakesTooLongRestsUntilItAnswers) {
  meet_helper();
  sharing_.hand(job(), now_ns_);
  now_ns_ += RoundSharing::kPatienceNs;
  EXPECT_TRUE(sharing_.take_back(now_ns_).empty());
  EXPECT_EQ(sharing_.take_back(++now_ns_).size(), 1U);
  EXPECT_FALSE(sharing_.has_idle(now_ns_));
  let_it_answer();
  EXPECT_TRUE(sampled_.empty());
  EXPECT_TRUE(sharing_.has_idle(now_ns_));
  sharing_.hand(job(), now_ns_);
  ASSERT_TRUE(until([&] { return sampled_.size() == 1; }));
}

TEST_F(RoundSharingTest, ARoundWhosePicturesAreGoneOrThatLiesIsRefused) {
  bus::Subscriber refusals(connect("refusals"), {"sampling/result"});
  ASSERT_TRUE(refusals.wait_connected(bus_test::patience));
  meet_helper();
  const bus::Publisher publisher(lead_);
  bus::TensorRing ring(lead_, "few", 1);
  const auto refusal = [&](const InputJob& said, const InputJob& pictures, const std::string& to) -> std::string {
    publisher.publish(topics::kSamplingRound, {.tensors = ring.write(round_tensors(pictures))},
                      [&](auto& builder, auto header) { return write_round(builder, header, to, 1, said); });
    std::string reason = "none";
    bus_test::eventually(
        [&] {
          helper_.step(1ms);
          const auto message = refusals.receive(0ms);
          if (message) reason = message->root<wire::SamplingResult>().refused()->str();
          return message.has_value();
        },
        to == "capture-bridge-2" ? bus_test::patience : 200ms);
    return reason;
  };
  const InputJob round = job();
  EXPECT_EQ(refusal(round, job(3), "capture-bridge-3"), "none") << "it is another's";
  EXPECT_EQ(refusal(round, job(3), "capture-bridge-2"), "its pictures are gone");
  InputJob sizes = round;
  auto larger = *round.views.back();
  larger.camera.width = 2 * kSize;
  sizes.views.back() = std::make_shared<const InputView>(larger);
  EXPECT_EQ(refusal(sizes, round, "capture-bridge-2"), "sampling/round: views of several sizes");
  InputJob options = round;
  options.options.budget = std::size_t{1} << 40;
  EXPECT_EQ(refusal(options, round, "capture-bridge-2"), "sampling/round: options that nobody can set");
  EXPECT_EQ(helper_.counters().refused, 3U);
  EXPECT_EQ(helper_.counters().rounds, 0U);
}

TEST_F(RoundSharingTest, WhoRefusesRestsAndItsRoundComesBack) {
  meet_helper();
  helps_ = false;
  sharing_.hand(job(), now_ns_);
  const std::uint64_t id = handed_id();
  bus::Publisher(other_).publish(topics::kSamplingResult, [&](auto& builder, auto header) {
    return wire::CreateSamplingResult(builder, header, id, builder.CreateString("no device"));
  });
  let_it_answer();
  EXPECT_EQ(sharing_.take_back(now_ns_).size(), 1U);
  EXPECT_FALSE(sharing_.has_idle(now_ns_ + RoundSharing::kRestNs - 1));
  EXPECT_TRUE(sharing_.has_idle(now_ns_ + RoundSharing::kRestNs));
}

TEST_F(RoundSharingTest, AnAnswerWithoutSamplesOrOfSomebodyElseTakesNoRoundAway) {
  meet_helper();
  helps_ = false;
  const std::vector<float> many(3 * 501);
  const auto lie = [](const char* name, const void* data) {
    return bus::OutgoingTensor{.name = name, .shape = {501, 3}, .inline_data = data};
  };
  std::vector<bus::OutgoingTensor> too_many;
  for (const char* name : kSampleTensors) too_many.push_back(lie(name, many.data()));
  for (const auto& tensors : {std::vector<bus::OutgoingTensor>{}, too_many}) {
    sharing_.hand(job(), now_ns_);
    const std::uint64_t id = handed_id();
    answer(id, connect("stranger"), too_many);
    let_it_answer();
    answer(id + 1, other_, too_many);
    let_it_answer();
    EXPECT_TRUE(sharing_.take_back(now_ns_).empty());
    answer(id, other_, tensors);
    let_it_answer();
    EXPECT_EQ(sharing_.take_back(now_ns_).size(), 1U);
    now_ns_ += RoundSharing::kRestNs;
  }
  EXPECT_EQ(subscriber_.refused(), 1U);
  EXPECT_TRUE(sampled_.empty());
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
