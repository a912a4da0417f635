// softmax(q k^T * scale) v for each head, without scores in memory: FlashAttention-2 (Dao 2023), for GPUs from compute
// capability 8.0 on.
//
// A block of 4 warps has 64 or 128 queries of one head and goes through the keys, 64 at a time: while it computes with
// some, the next are on their way into shared memory. A warp has 16 or 32 queries to itself; their scores, sums of values
// and the queries themselves stay in its registers. Scores, the softmax and all sums are in f32, and so is the result.

using u8 = unsigned char;
using u16 = unsigned short;
using u64 = unsigned long long;

// Vectors of numbers of 16 bits, channels side by side; strides count numbers.
struct Rows {
    const u16* first;
    u64 batch_stride;
    u64 token_stride;
};

// Keys and values of some tokens.
struct Memory {
    Rows k;
    Rows v;
    unsigned tokens;
};

constexpr int MEMORIES = 48;

// As in src/nn/cuda.rs.
struct Arguments {
    Rows q;
    float* out;  // (groups, batch, queries, heads, dim), contiguous
    unsigned queries;
    unsigned heads;
    unsigned dim;  // channels of a head, a multiple of 8
    unsigned batch;  // of a group
    unsigned causal;  // whether a query attends to no later keys than itself
    float scale;  // of scores as exponents of 2
    Memory memories[MEMORIES];
    u16 starts[MEMORIES + 1];  // of each group's own in what follows, and the end of the last
    u8 of_groups[1024];  // memories that each group attends to
};

constexpr int THREADS = 128;
// Keys at a time.
constexpr int KEYS = 64;
constexpr float INFINITE = __builtin_huge_valf();

struct Bf16 {
    static __device__ unsigned pair(float low, float high) {
        unsigned both;
        asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(high), "f"(low));
        return both;
    }

    // sum += a b, where a is 16 x 16 and b 16 x 8.
    static __device__ void multiply(float (&sum)[4], const unsigned (&a)[4], unsigned b0, unsigned b1) {
        asm("mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
            "{%0, %1, %2, %3};"
            : "+f"(sum[0]), "+f"(sum[1]), "+f"(sum[2]), "+f"(sum[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
    }
};

struct F16 {
    static __device__ unsigned pair(float low, float high) {
        unsigned both;
        asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(high), "f"(low));
        return both;
    }

    static __device__ void multiply(float (&sum)[4], const unsigned (&a)[4], unsigned b0, unsigned b1) {
        asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
            "{%0, %1, %2, %3};"
            : "+f"(sum[0]), "+f"(sum[1]), "+f"(sum[2]), "+f"(sum[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
    }
};

__device__ unsigned shared_address(const void* at) {
    return static_cast<unsigned>(__cvta_generic_to_shared(at));
}

// Begins to copy 16 bytes into shared memory; zeros, if they are not `there`.
__device__ void copy(u16* to, const u16* from, bool there) {
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;"
                 :
                 : "r"(shared_address(to)), "l"(from), "r"(there ? 16 : 0)
                 : "memory");
}

// Waits until all that this thread copies is there.
__device__ void wait_for_copies() {
    asm volatile("cp.async.wait_all;" ::: "memory");
}

// Four matrices of 8 x 8; the lanes say where their 32 rows are.
__device__ void load(unsigned (&to)[4], const u16* row) {
    asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0, %1, %2, %3}, [%4];"
                 : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
                 : "r"(shared_address(row))
                 : "memory");
}

// As `load`, each transposed.
__device__ void load_transposed(unsigned (&to)[4], const u16* row) {
    asm volatile("ldmatrix.sync.aligned.m8n8.x4.trans.shared.b16 {%0, %1, %2, %3}, [%4];"
                 : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
                 : "r"(shared_address(row))
                 : "memory");
}

__device__ float power_of_two(float x) {
    float power;
    asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(power) : "f"(x));
    return power;
}

// Over the four lanes that share rows of a product.
__device__ float max_of_row(float x) {
    x = fmaxf(x, __shfl_xor_sync(~0u, x, 1));
    return fmaxf(x, __shfl_xor_sync(~0u, x, 2));
}

__device__ float sum_of_row(float x) {
    x += __shfl_xor_sync(~0u, x, 1);
    return x + __shfl_xor_sync(~0u, x, 2);
}

// Heads of up to DIM channels, 64 TILES queries in a block.
template <class Element, int DIM, int TILES>
__device__ void attend(const Arguments& arguments) {
    constexpr int QUERIES = 64 * TILES;
    // 16 bytes, of each row.
    constexpr int CHUNKS = DIM / 8;
    // An odd number of times 16 bytes: the 8 rows of a matrix are in different banks.
    constexpr int PITCH = DIM + 8;
    // Keys, then values.
    constexpr int STAGE = 2 * KEYS * PITCH;
    // That a thread copies of keys.
    constexpr int COPIES = KEYS * CHUNKS / THREADS;
    static_assert(QUERIES <= 2 * KEYS && DIM % 16 == 0);

    __shared__ __align__(16) u16 stages[2 * STAGE];

    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    const unsigned blocks = (arguments.queries + QUERIES - 1) / QUERIES;
    const unsigned first = blockIdx.x % blocks * QUERIES;
    const unsigned head = blockIdx.x / blocks % arguments.heads;
    const unsigned batch = blockIdx.x / blocks / arguments.heads;
    const unsigned dim = arguments.dim;
    auto source = [&](const Rows& rows, unsigned batch, unsigned token, int column) {
        return rows.first + batch * rows.batch_stride + token * rows.token_stride + head * dim + column;
    };

    const unsigned of_group = batch % arguments.batch;
    unsigned next_memory = arguments.starts[batch / arguments.batch], next_token = 0;
    const unsigned last_memory = arguments.starts[batch / arguments.batch + 1];
    auto memory_at = [&](unsigned i) -> const Memory& { return arguments.memories[arguments.of_groups[i]]; };
    unsigned keys = 0;
    for (unsigned i = next_memory; i < last_memory; ++i) {
        keys += memory_at(i).tokens;
    }
    // Goes from a token beyond a memory on to the memory that has it.
    auto find = [&](unsigned& memory, unsigned& token) {
        while (memory < last_memory && token >= memory_at(memory).tokens) {
            token -= memory_at(memory).tokens;
            ++memory;
        }
    };
    auto copy_next_keys = [&](u16* stage) {
#pragma unroll
        for (int i = 0; i < COPIES; ++i) {
            const int row = (threadIdx.x + i * THREADS) / CHUNKS, column = (threadIdx.x + i * THREADS) % CHUNKS * 8;
            unsigned memory = next_memory, token = next_token + row;
            find(memory, token);
            const bool there = memory < last_memory && column < dim;
            const Memory& from = memory_at(there ? memory : 0);
            u16* to = stage + row * PITCH + column;
            copy(to, there ? source(from.k, of_group, token, column) : from.k.first, there);
            copy(to + KEYS * PITCH, there ? source(from.v, of_group, token, column) : from.v.first, there);
        }
        next_token += KEYS;
        find(next_memory, next_token);
        // Lanes may have searched for different times; products are for all lanes at once.
        __syncwarp();
    };

    // Queries pass through the second stage.
#pragma unroll
    for (int i = 0; i < COPIES * TILES; ++i) {
        const int row = (threadIdx.x + i * THREADS) / CHUNKS, column = (threadIdx.x + i * THREADS) % CHUNKS * 8;
        const bool there = first + row < arguments.queries && column < dim;
        const u16* from = there ? source(arguments.q, batch, first + row, column) : arguments.q.first;
        copy(stages + STAGE + row * PITCH + column, from, there);
    }
    copy_next_keys(stages);
    wait_for_copies();
    __syncthreads();
    unsigned q[TILES][DIM / 16][4];
#pragma unroll
    for (int tile = 0; tile < TILES; ++tile) {
#pragma unroll
        for (int step = 0; step < DIM / 16; ++step) {
            const int row = (warp * TILES + tile) * 16 + lane % 16;
            load(q[tile][step], stages + STAGE + row * PITCH + step * 16 + lane / 16 * 8);
        }
    }

    // A lane has two of 8 columns, of rows lane / 4 and lane / 4 + 8.
    float sums[TILES][DIM / 8][4] = {};
    float weights[TILES][2] = {};
    float greatest[TILES][2];
#pragma unroll
    for (int tile = 0; tile < TILES; ++tile) {
        greatest[tile][0] = greatest[tile][1] = -INFINITE;
    }

    const unsigned end = arguments.causal ? min(keys, first + QUERIES) : keys;
    for (unsigned start = 0, at = 0; start < end; start += KEYS, at ^= 1) {
        wait_for_copies();
        // All warps' copies are there, and none uses the other stage any more.
        __syncthreads();
        if (start + KEYS < end) {
            copy_next_keys(stages + (at ^ 1) * STAGE);
        }
        if (first + warp * TILES * 16 >= arguments.queries) {
            // This warp only copies.
            continue;
        }
        const u16* k = stages + at * STAGE;
        const u16* v = k + KEYS * PITCH;

        float scores[TILES][KEYS / 8][4] = {};
#pragma unroll
        for (int step = 0; step < DIM / 16; ++step) {
#pragma unroll
            for (int key = 0; key < KEYS / 16; ++key) {
                unsigned b[4];
                load(b, k + (key * 16 + lane / 16 * 8 + lane % 8) * PITCH + step * 16 + lane / 8 % 2 * 8);
#pragma unroll
                for (int tile = 0; tile < TILES; ++tile) {
                    Element::multiply(scores[tile][2 * key], q[tile][step], b[0], b[1]);
                    Element::multiply(scores[tile][2 * key + 1], q[tile][step], b[2], b[3]);
                }
            }
        }

        if (start + KEYS > keys || (arguments.causal && start + KEYS > first)) {
#pragma unroll
            for (int tile = 0; tile < TILES; ++tile) {
#pragma unroll
                for (int i = 0; i < KEYS / 8 * 4; ++i) {
                    const unsigned key = start + i / 4 * 8 + lane % 4 * 2 + i % 2;
                    const unsigned query = first + (warp * TILES + tile) * 16 + lane / 4 + i % 4 / 2 * 8;
                    if (key >= keys || (arguments.causal && key > query)) {
                        scores[tile][i / 4][i % 4] = -INFINITE;
                    }
                }
            }
        }

#pragma unroll
        for (int tile = 0; tile < TILES; ++tile) {
#pragma unroll
            for (int half = 0; half < 2; ++half) {
                float most = -INFINITE;
#pragma unroll
                for (int i = 0; i < KEYS / 8; ++i) {
                    most = fmaxf(most, fmaxf(scores[tile][i][2 * half], scores[tile][i][2 * half + 1]));
                }
                // The first key is for every query, so this is finite.
                const float now = fmaxf(greatest[tile][half], max_of_row(most) * arguments.scale);
                const float fade = power_of_two(greatest[tile][half] - now);
                greatest[tile][half] = now;
                float sum = weights[tile][half] * fade;
#pragma unroll
                for (int i = 0; i < KEYS / 8; ++i) {
#pragma unroll
                    for (int j = 2 * half; j < 2 * half + 2; ++j) {
                        scores[tile][i][j] = power_of_two(fmaf(scores[tile][i][j], arguments.scale, -now));
                        sum += scores[tile][i][j];
                    }
                }
                weights[tile][half] = sum;
#pragma unroll
                for (int i = 0; i < DIM / 8; ++i) {
                    sums[tile][i][2 * half] *= fade;
                    sums[tile][i][2 * half + 1] *= fade;
                }
            }
        }

#pragma unroll
        for (int key = 0; key < KEYS / 16; ++key) {
            // What a lane has of a product is what it needs of a factor.
            unsigned a[TILES][4];
#pragma unroll
            for (int tile = 0; tile < TILES; ++tile) {
#pragma unroll
                for (int i = 0; i < 4; ++i) {
                    const float* of = scores[tile][2 * key + i / 2] + i % 2 * 2;
                    a[tile][i] = Element::pair(of[0], of[1]);
                }
            }
#pragma unroll
            for (int step = 0; step < DIM / 16; ++step) {
                unsigned b[4];
                load_transposed(b, v + (key * 16 + lane % 16) * PITCH + step * 16 + lane / 16 * 8);
#pragma unroll
                for (int tile = 0; tile < TILES; ++tile) {
                    Element::multiply(sums[tile][2 * step], a[tile], b[0], b[1]);
                    Element::multiply(sums[tile][2 * step + 1], a[tile], b[2], b[3]);
                }
            }
        }
    }

#pragma unroll
    for (int tile = 0; tile < TILES; ++tile) {
#pragma unroll
        for (int half = 0; half < 2; ++half) {
            const float share = 1 / sum_of_row(weights[tile][half]);
            const unsigned query = first + (warp * TILES + tile) * 16 + lane / 4 + half * 8;
            if (query >= arguments.queries) {
                continue;
            }
            float* to = arguments.out + ((u64(batch) * arguments.queries + query) * arguments.heads + head) * dim;
#pragma unroll
            for (int i = 0; i < DIM / 8; ++i) {
                if (i * 8 < dim) {
                    const float* of = sums[tile][i] + 2 * half;
                    reinterpret_cast<float2*>(to)[i * 4 + lane % 4] = make_float2(of[0] * share, of[1] * share);
                }
            }
        }
    }
}

// With so many blocks on a multiprocessor, no register is spilled on any generation so far (ptxas -v).
#define KERNEL(type, Element, dim, tiles)                                                 \
    extern "C" __global__ void __launch_bounds__(THREADS, tiles == 1 ? 3 : 2)             \
        attention_##type##_##dim##_##tiles(const __grid_constant__ Arguments arguments) { \
        attend<Element, dim, tiles>(arguments);                                           \
    }
#define KERNELS(dim, tiles)          \
    KERNEL(bf16, Bf16, dim, tiles)   \
    KERNEL(f16, F16, dim, tiles)

KERNELS(16, 1)
KERNELS(16, 2)
KERNELS(32, 1)
KERNELS(32, 2)
KERNELS(64, 1)
KERNELS(64, 2)
// Of twice as many queries, registers would not hold the sums.
KERNELS(80, 1)
