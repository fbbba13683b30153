// What the steps of the depth sort have in common.
layout(local_size_x = 256) in;
const uint kThreads = 256u;
const uint kEach = 16u;  // keys of a thread
const uint kBlock = kEach * kThreads;
const uint kBatch = 128u;
const uint kDigits = 32u;

struct Counted {
  uint rows;
  uint groups[3];
};

shared uint partial[kThreads];

void synchronise() {
  memoryBarrierShared();
  barrier();
}

// Sum over the threads before this one; the sum over all is left in partial[kThreads - 1].
uint sumBefore(uint thread, uint value) {
  partial[thread] = value;
  for (uint apart = 1u; apart < kThreads; apart *= 2u) {
    synchronise();
    uint other = thread >= apart ? partial[thread - apart] : 0u;
    synchronise();
    partial[thread] += other;
  }
  synchronise();
  return partial[thread] - value;
}
