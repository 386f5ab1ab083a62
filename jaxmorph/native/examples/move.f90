! cc -O3 -x c -DJMPLAN_IMPLEMENTATION -c "$(jaxmorph native)/jmplan.h" -o jmplan.o
! gfortran move.f90 jmplan.o -o move -lm && ./move wing.plan
module jmplan
  use iso_c_binding
  implicit none
  interface
    type(c_ptr) function jm_open(path) bind(c)
      import; character(kind=c_char), intent(in) :: path(*)
    end function
    type(c_ptr) function jm_error(plan) bind(c)
      import; type(c_ptr), value :: plan
    end function
    integer(c_int64_t) function jm_dimension(plan) bind(c)
      import; type(c_ptr), value :: plan
    end function
    integer(c_int64_t) function jm_count(plan) bind(c)
      import; type(c_ptr), value :: plan
    end function
    integer(c_int64_t) function jm_moving(plan) bind(c)
      import; type(c_ptr), value :: plan
    end function
    integer(c_int) function jm_deform(plan, u, points) bind(c)
      import; type(c_ptr), value :: plan
      real(c_double), intent(in) :: u(*)
      real(c_double), intent(out) :: points(*)
    end function
    integer(c_int) function jm_pullback(plan, points_bar, u_bar) bind(c)
      import; type(c_ptr), value :: plan
      real(c_double), intent(in) :: points_bar(*)
      real(c_double), intent(out) :: u_bar(*)
    end function
    subroutine jm_close(plan) bind(c)
      import; type(c_ptr), value :: plan
    end subroutine
  end interface
end module

program move
  use jmplan
  implicit none
  character(len=1024) :: path
  type(c_ptr) :: plan
  real(c_double), allocatable :: u(:, :), points(:, :)   ! a column for each point
  integer(c_int64_t) :: i
  call get_command_argument(1, path)
  plan = jm_open(trim(path)//c_null_char)
  if (c_associated(jm_error(plan))) error stop "the plan cannot be used"
  allocate (u(jm_dimension(plan), jm_moving(plan)), points(jm_dimension(plan), jm_count(plan)))
  u = 0
  u(2, :) = 0.1d0                                        ! the wall goes up by 0.1
  if (jm_deform(plan, u, points) /= 0) error stop "memory is short"
  do i = 1, size(points, 2)
    print '(3es25.16)', points(:, i)
  end do
  call jm_close(plan)
end program
