/// Disjoint sets with the two numbers that the segmentation criterion needs of each.
struct Forest {
    parent: Vec<u32>,
    size: Vec<u32>,
    /// Internal difference plus k/|C|, of roots.
    limit: Vec<f32>,
}

/// An edge of a weighted graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    /// One end.
    pub(super) a: u32,
    /// The other.
    pub(super) b: u32,
    /// How unlike the two are; finite, not negative.
    pub(super) weight: f32,
}

impl Forest {
    /// `count` sets of one.
    fn new(count: usize, k: f32) -> Self {
        Self {
            parent: (0..count as u32).collect(),
            size: vec![1; count],
            limit: vec![k; count],
        }
    }

    /// The representative of the set of `i`.
    fn find(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            let above = self.parent[self.parent[i as usize] as usize];
            self.parent[i as usize] = above;
            i = above;
        }
        i
    }

    fn join(&mut self, a: u32, b: u32) -> u32 {
        let (root, leaf) = if self.size[a as usize] >= self.size[b as usize] {
            (a, b)
        } else {
            (b, a)
        };
        self.parent[leaf as usize] = root;
        self.size[root as usize] += self.size[leaf as usize];
        root
    }
}

/// Felzenszwalb and Huttenlocher, "Efficient Graph-Based Image Segmentation" (2004), algorithm 1.
///
/// Edges are taken by increasing weight w; the sets C1, C2 of their ends become one if
/// w ≤ min(Int(C1) + k/|C1|, Int(C2) + k/|C2|), Int being the largest weight inside. Then, again by
/// increasing weight, sets of fewer than `min_size` join a neighbour over an edge of at most
/// `max_weight`.
pub(super) fn segment(
    nodes: usize,
    edges: &[Edge],
    k: f32,
    min_size: u32,
    max_weight: f32,
) -> Vec<u32> {
    let order = by_weight(edges);
    let mut forest = Forest::new(nodes, k);
    for &e in &order {
        let Edge { a, b, weight } = edges[e as usize];
        let (a, b) = (forest.find(a), forest.find(b));
        if a != b && weight <= forest.limit[a as usize].min(forest.limit[b as usize]) {
            let root = forest.join(a, b);
            forest.limit[root as usize] = weight + k / forest.size[root as usize] as f32;
        }
    }
    for &e in &order {
        let Edge { a, b, weight } = edges[e as usize];
        if weight > max_weight {
            break;
        }
        let (a, b) = (forest.find(a), forest.find(b));
        if a != b && forest.size[a as usize].min(forest.size[b as usize]) < min_size {
            forest.join(a, b);
        }
    }
    (0..nodes as u32).map(|node| forest.find(node)).collect()
}

/// The indices of `edges` by increasing weight, equal ones in their order: three passes of a radix
/// sort over the bits of the weights, which order floats that are not negative as they are.
fn by_weight(edges: &[Edge]) -> Vec<u32> {
    const DIGIT: u32 = 11;
    let mut order: Vec<u32> = (0..edges.len() as u32).collect();
    let mut sorted = vec![0; edges.len()];
    for shift in [0, DIGIT, 2 * DIGIT] {
        let digit =
            |e: u32| (edges[e as usize].weight.to_bits() >> shift) as usize & ((1 << DIGIT) - 1);
        let mut starts = vec![0usize; (1 << DIGIT) + 1];
        for &e in &order {
            starts[digit(e) + 1] += 1;
        }
        for d in 0..1 << DIGIT {
            starts[d + 1] += starts[d];
        }
        for &e in &order {
            let place = &mut starts[digit(e)];
            sorted[*place] = e;
            *place += 1;
        }
        std::mem::swap(&mut order, &mut sorted);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn edge(a: u32, b: u32, weight: f32) -> Edge {
        Edge { a, b, weight }
    }

    /// Sets as a partition: nodes get the number of the first node that they are with.
    fn partition(roots: &[u32]) -> Vec<usize> {
        roots
            .iter()
            .map(|root| roots.iter().position(|r| r == root).unwrap())
            .collect()
    }

    #[test]
    fn a_chain_breaks_where_the_weight_exceeds_the_internal_difference() {
        // k = 2: 0-1 merge (1 ≤ 2), limit 1 + 2/2 = 2; 2-3 likewise; 1-2 at 2.5 stays an edge.
        let edges = [edge(0, 1, 1.0), edge(1, 2, 2.5), edge(2, 3, 1.0)];
        assert_eq!(partition(&segment(4, &edges, 2.0, 0, 0.0)), [0, 0, 2, 2]);
        // k = 3: the limits are 1 + 3/2 = 2.5, which 2.5 does not exceed.
        assert_eq!(partition(&segment(4, &edges, 3.0, 0, 0.0)), [0, 0, 0, 0]);
    }

    #[test]
    fn small_sets_join_over_weights_up_to_the_limit_only() {
        let edges = [edge(0, 1, 0.0), edge(1, 2, 5.0), edge(2, 3, 9.0)];
        assert_eq!(partition(&segment(4, &edges, 0.1, 2, 6.0)), [0, 0, 0, 3]);
        assert_eq!(partition(&segment(4, &edges, 0.1, 1, 6.0)), [0, 0, 2, 3]);
    }

    /// Algorithm 1 word for word, with sets as labels and the internal difference kept apart.
    fn plainly(nodes: usize, edges: &[Edge], k: f32) -> Vec<u32> {
        let mut sorted = edges.to_vec();
        sorted.sort_by(|a, b| a.weight.total_cmp(&b.weight));
        let mut set: Vec<u32> = (0..nodes as u32).collect();
        let mut internal = vec![0.0; nodes];
        for Edge { a, b, weight } in sorted {
            let (a, b) = (set[a as usize], set[b as usize]);
            let limit =
                |s: u32| internal[s as usize] + k / set.iter().filter(|&&x| x == s).count() as f32;
            if a != b && weight <= limit(a).min(limit(b)) {
                set.iter_mut().filter(|s| **s == b).for_each(|s| *s = a);
                internal[a as usize] = weight;
            }
        }
        set
    }

    proptest! {
        #[test]
        fn agrees_with_the_algorithm_as_published(
            edges in prop::collection::vec((0u32..12, 0u32..12, 0u8..20), 0..60),
            k in 0.0f32..30.0,
        ) {
            let edges: Vec<Edge> =
                edges.iter().map(|&(a, b, w)| edge(a, b, 0.37 * f32::from(w))).collect();
            let fast = segment(12, &edges, k, 0, 0.0);
            prop_assert_eq!(partition(&fast), partition(&plainly(12, &edges, k)));
        }

        #[test]
        fn the_order_is_that_of_a_stable_sort(
            weights in prop::collection::vec(prop_oneof![Just(0.0f32), Just(1.0), 0.0f32..1e30], 0..200),
        ) {
            let edges: Vec<Edge> = weights.iter().map(|&w| edge(0, 0, w)).collect();
            let mut expected: Vec<u32> = (0..edges.len() as u32).collect();
            expected.sort_by(|&a, &b| {
                edges[a as usize].weight.total_cmp(&edges[b as usize].weight)
            });
            prop_assert_eq!(by_weight(&edges), expected);
        }
    }
}
